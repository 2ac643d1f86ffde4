"""The entry: see `benchmarks.gauntlet`."""

import argparse
import hashlib
import subprocess
import sys
import time

from .judge import judge
from .outcome import Outcome
from .workers import Job, carry_out

FIXED, DRAWN = 60, 12


def drawn_seeds(start: int) -> range:
    """Return the seeds of campaigns that are drawn anew."""
    return range(start, start + DRAWN)


def seed_of_commit() -> int:
    """Return the first seed for this commit, beyond the fixed ones."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, check=True).stdout  # noqa: S607
    return FIXED + int(hashlib.sha256(commit).hexdigest()[:7], 16)


def show(outcome: Outcome) -> None:
    """Print a line for an outcome, and one for each failure."""
    spent = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in outcome.seconds.items())
    figures = ", ".join(f"{name} {value:.4g}" for name, value in outcome.figures.items() if value is not None)
    sys.stdout.write(f"{time.strftime('%H:%M:%S')} {outcome.name}: {outcome.result}; {spent} s; {figures}\n")
    sys.stdout.write(f"    {outcome.words}\n" if outcome.words else "")
    for sentence in (*outcome.verdicts, *(f"FAILED {failure}" for failure in outcome.failures)):
        sys.stdout.write(f"    {sentence}\n")
    if outcome.message and outcome.result != "model":
        sys.stdout.write("".join(f"      {line}\n" for line in outcome.message.splitlines()))
    sys.stdout.flush()


def zoo_jobs(seeds: range | list[int], *, physics: bool, keep: str | None = None) -> list[Job]:
    """Return a job for each campaign."""
    words = "physics" if physics else "default"
    return [
        Job(f"zoo {seed}, {words}", judge, {"seed": seed, "physics": physics, "folder": keep})
        for seed in seeds
    ]


def main() -> int:
    """Run what is asked for; return 1 where something failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gauntlet")
    parser.add_argument("--zoo", type=int, nargs="+", default=[])
    parser.add_argument("--physics", action="store_true")
    parser.add_argument("--keep")
    asked = parser.parse_args()
    outcomes: list[Outcome] = []

    def report(outcome: Outcome) -> None:
        outcomes.append(outcome)
        show(outcome)

    carry_out(zoo_jobs(asked.zoo, physics=asked.physics, keep=asked.keep), report)
    return int(any(outcome.failures for outcome in outcomes))


if __name__ == "__main__":
    raise SystemExit(main())
