"""The entry: see `benchmarks.gauntlet`."""

import argparse
import hashlib
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from .bars import compare, read_bars, zoo_total
from .judge import judge
from .measured import ALONE, SETS, WARM_SETS, judge_set, judge_speed, missing
from .outcome import MODEL, Outcome
from .page import page
from .workers import Job, run_jobs

FIXED_CAMPAIGNS, DRAWN_CAMPAIGNS = 60, 4
PAGE = Path(__file__).parents[1] / "gauntlet.md"
SINGLE_PROCESS = 1


def main() -> int:
    """Run what is asked for; return 1 where something failed."""
    arguments = _arguments()
    started, outcomes = time.perf_counter(), []

    def report(outcome: Outcome) -> None:
        compare([outcome], bars)
        outcomes.append(outcome)
        _say(outcome, time.perf_counter() - started)

    bars = read_bars()
    seed = _seed_of_commit() if arguments.seed is None else arguments.seed
    single = bool(arguments.zoo or arguments.set)
    sets = arguments.set if single else [*SETS]
    missing_sets = [name for name in sets if missing(name)]
    sets = [name for name in sets if name not in missing_sets]
    for name in missing_sets:
        sys.stdout.write(f"left out: {name}, its folder is missing; set HITCHID_DATA\n")
    jobs = [Job(name, judge_set, {"name": name}) for name in sets if name != ALONE]
    if single:
        jobs += _campaigns(arguments.zoo, physics=arguments.physics, keep=arguments.keep)
    else:
        sys.stdout.write(
            f"{DRAWN_CAMPAIGNS} campaigns are drawn from seed {seed} on; --seed {seed} repeats them\n"
        )
        seeds = range(FIXED_CAMPAIGNS) if arguments.full else range(seed, seed + DRAWN_CAMPAIGNS)
        jobs += _campaigns(seeds, physics=False)
        jobs += [] if arguments.full else _campaigns(range(FIXED_CAMPAIGNS), physics=True)
    sys.stdout.flush()
    run_jobs(jobs, report)
    # Times are of a machine that does nothing else.
    timed = [Job(f"{name}, warm", judge_speed, {"name": name}) for name in WARM_SETS if name in sets]
    timed += [Job(ALONE, judge_set, {"name": ALONE})] if ALONE in sets else []
    run_jobs(timed, report, together=SINGLE_PROCESS)
    if not single:
        report(zoo_total(outcomes))
        PAGE.write_text(page(outcomes, bars, left_out=missing_sets, seed=seed), encoding="utf-8")
    failed = [outcome.name for outcome in outcomes if outcome.failures]
    sys.stdout.write(f"{len(outcomes)} runs, failed: {', '.join(failed) or 'none'}\n")
    return int(bool(failed))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gauntlet")
    parser.add_argument("--full", action="store_true", help="all sixty campaigns by default identify")
    parser.add_argument("--seed", type=int, help="of the first campaign drawn anew; by default the commit's")
    parser.add_argument("--set", nargs="+", choices=list(SETS), default=[], help="these measured sets")
    parser.add_argument("--zoo", type=int, nargs="+", default=[], help="these campaigns of the zoo")
    parser.add_argument("--physics", action="store_true", help="with --zoo: no training, no comparison")
    parser.add_argument("--keep", help="with --zoo: folder in which the logs stay")
    return parser.parse_args()


def _seed_of_commit() -> int:
    """Return the first seed for this commit, beyond the fixed ones."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, check=True).stdout  # noqa: S607
    return FIXED_CAMPAIGNS + int(hashlib.sha256(commit).hexdigest()[:7], 16)


def _campaigns(seeds: Iterable[int], *, physics: bool, keep: str | None = None) -> list[Job]:
    label = "physics" if physics else "default"
    return [
        Job(f"zoo {seed}, {label}", judge, {"seed": seed, "physics": physics, "folder": keep})
        for seed in seeds
    ]


def _say(outcome: Outcome, elapsed_s: float) -> None:
    """Print a line for an outcome, and what is to be known of it."""
    times = ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in outcome.seconds.items())
    figures = "; ".join(f"{name} {value:.4g}" for name, value in outcome.figures.items())
    text = f"[{elapsed_s:5.0f} s] {outcome.name}: {outcome.result}; {times}; {figures}\n"
    if outcome.description:
        text += f"    {outcome.description}\n"
    for sentence in (*outcome.verdicts, *(f"FAILED {failure}" for failure in outcome.failures)):
        text += f"    {sentence}\n"
    if outcome.result != MODEL:
        text += "".join(f"      {line}\n" for line in outcome.message.splitlines())
    sys.stdout.write(text)
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
