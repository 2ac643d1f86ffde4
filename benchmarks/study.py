"""Phase 1 on measured tests: three searches on one budget over ten seeds, against 64-start least squares.

Reads the data set `rig-a` below the folder named by HITCHID_DATA; prints a Markdown table.
"""

import os
import sys
import time
from pathlib import Path

import jax
import numpy as np

from hitchid.estimation import EVALUATIONS, DifferentialEvolution, MultiStart, Search, Whale
from hitchid.estimation.whale import WhaleConfig
from hitchid.identification.identify import PAPER_SPECS
from hitchid.identification.phase1 import identify_benchmark
from hitchid.identification.preparation import prepare
from hitchid.logs import read
from hitchid.structures import ModelSpec

SEEDS = range(10)
DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
SEARCHES: dict[str, Search] = {
    "whale": Whale(),
    "whale, half the budget": Whale(WhaleConfig(iterations=50, evaluations=EVALUATIONS // 2)),
    "whale, one draw a whale": Whale(WhaleConfig(evaluations=EVALUATIONS, per_dimension=False)),
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
    for direction in campaign.directions:
        tests = prepare(campaign, direction, None)

        def run(
            search: Search, seed: int, *, batch=tests.all_tests, form: ModelSpec = PAPER_SPECS[direction]
        ):
            return identify_benchmark(batch, form, search, seed, units=units)

        best = run(MultiStart(evaluations=10**6, starts=64), 0).rmse
        say(f"| {direction} | 64-start least squares | | | {best:.6f} | | |\n")
        for name, search in SEARCHES.items():
            start = time.perf_counter()
            results = [run(search, seed) for seed in SEEDS]
            mean_seconds = (time.perf_counter() - start) / len(results)
            search_errors = np.array([result.search_rmse for result in results])
            refined_errors = np.array([result.rmse for result in results])
            say(
                f"| {direction} | {name} | {np.median(search_errors):.6f} | {search_errors.max():.6f} | "
                f"{np.median(refined_errors):.6f} "
                f"| {refined_errors.max() / best:.6f} | {mean_seconds:.1f} |\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
