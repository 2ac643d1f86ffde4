"""Phase 1 on measured tests: three searches on one budget over ten seeds, against 64-start least squares.

Reads the data set `rig-a` below the folder named by HITCHID_DATA; prints a Markdown table.
"""

import os
import sys
import time
from pathlib import Path

import jax
import numpy as np

from hitchid.estimation.search import EVALUATIONS, DifferentialEvolution, MultiStart, Search, Whale
from hitchid.estimation.whale import Swarm
from hitchid.identification.identify import PAPER_FORMS
from hitchid.identification.phase1 import identify_benchmark
from hitchid.identification.preparation import prepare
from hitchid.readers import read
from hitchid.structures import Form

SEEDS = range(10)
DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
SEARCHES: dict[str, Search] = {
    "whale": Whale(),
    "whale, half the budget": Whale(Swarm(iterations=50, evaluations=EVALUATIONS // 2)),
    "whale, one draw a whale": Whale(Swarm(evaluations=EVALUATIONS, per_dimension=False)),
    "differential evolution": DifferentialEvolution(),
    "multi-start least squares": MultiStart(),
}


def main() -> None:
    """Run every search with every seed on both directions."""
    jax.config.update("jax_enable_x64", True)
    campaign = read(DATA / "rig-a")
    say = sys.stdout.write
    header = ("direction", "search", "before polish / mm", "worst", "after polish / mm", "worst / best", "s")
    say(f"| {' | '.join(header)} |\n|{' --- |' * len(header)}\n")
    units = {"x": "mm", "u": "A"}
    for mode in campaign.modes:
        tests = prepare(campaign, mode, None)

        def run(search: Search, seed: int, *, batch=tests.everything, form: Form = PAPER_FORMS[mode]):
            return identify_benchmark(batch, form, search, seed, units=units)

        best = run(MultiStart(evaluations=10**6, starts=64), 0).rmse
        say(f"| {mode} | 64-start least squares | | | {best:.6f} | | |\n")
        for name, search in SEARCHES.items():
            start = time.perf_counter()
            found = [run(search, seed) for seed in SEEDS]
            spent = (time.perf_counter() - start) / len(found)
            before = np.array([each.search_rmse for each in found])
            after = np.array([each.rmse for each in found])
            say(
                f"| {mode} | {name} | {np.median(before):.6f} | {before.max():.6f} | {np.median(after):.6f} "
                f"| {after.max() / best:.6f} | {spent:.1f} |\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
