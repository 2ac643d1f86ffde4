"""Writes the page of results: python page.py CALLS.json WHOLE.json RESULTS.md."""

import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from timings import OURS, Timing

COMPARISONS = {
    "phase1": (
        "Phase 1: the whale search",
        "Lifting tests of rig-a, the paper's third-order benchmark, 30 whales and 100 iterations, the same J "
        "in both programs. mealpy's objective discretises exactly and simulates all tests in one call of "
        "`lfilter`, its linear algebra on one thread, where it is fastest. Ours collects the tests' "
        "correlations first, within the time told; then an evaluation costs the same for any number of "
        "tests. The line with every evaluation simulated is ours without them.",
    ),
    "phase2": (
        "Phase 2: the compensator",
        "Seconds until the one-step error of the validation tests of rig-a first falls to what both sides "
        "reach. Same ten features, same target, 32 cells each; the peer reads windows of 50 samples. "
        "Programs compiled before.",
    ),
    "simulation": (
        "Simulation",
        "The same model in all programs, each result checked against the others. Real time is what the tests "
        "would last on a rig.",
    ),
    "many": (
        "Many campaigns at once",
        "Whole processes that read the logs and identify with the same options.",
    ),
    "whole": ("Whole programs", "From start to end as a user waits for them."),
}
PEERS = ("jax", "numpy", "scipy", "mealpy", "torch", "control", "sysidentpy")
HEADER = "| what | hitchid | beside it | times as fast |\n| --- | --- | --- | --- |\n"


@dataclass(frozen=True)
class Side:
    """Times of one who did a piece of work.

    Attributes:
        by: who did it.
        median, low, high: median and quartiles, s.
        runs: how often it was measured.
        note: what a reader should know.
    """

    by: str
    median: float
    low: float
    high: float
    runs: int
    note: str = ""

    @classmethod
    def of(cls, timing: Timing) -> "Side":
        """Return the median and the quartiles of whole runs."""
        low, median, high = np.percentile(timing.seconds, [25, 50, 75]).tolist()
        return cls(timing.by, median, low, high, len(timing.seconds), timing.note)

    @property
    def cell(self) -> str:
        """The times as the page tells them."""
        if self.runs == 1:
            return format_time(self.median)
        return f"{format_time(self.median)} [{format_time(self.low)}, {format_time(self.high)}]"


Works = dict[tuple[str, str], list[Side]]


def digits(number: float) -> str:
    """Return a number with three digits, or as a whole one."""
    return f"{number:.3g}" if number < 1000 else f"{number:.0f}"


def format_time(seconds: float) -> str:
    """Return a time in a unit that suits it."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1:
            return f"{digits(seconds * factor)} {unit}"
    return f"{digits(seconds * 1e6)} µs"


def collect(calls: Mapping, run_timings: Iterable[Timing]) -> Works:
    """Return part and work to those who did it, ours first."""
    works: Works = {}
    for entry in calls.get("benchmarks", ()):
        stats, info = entry["stats"], entry["extra_info"]
        sides = works.setdefault((info["part"], info["what"]), [])
        sides.append(Side(info["by"], stats["median"], stats["q1"], stats["q3"], stats["rounds"]))
        if info["bar"]:
            by, seconds = info["bar"]
            sides.append(Side(by, seconds, seconds, seconds, 1))
    for timing in run_timings:
        works.setdefault((timing.part, timing.what), []).append(Side.of(timing))
    for sides in works.values():
        sides.sort(key=lambda side: not side.by.startswith(OURS))
    return works


def lines(what: str, sides: list[Side]) -> Iterable[str]:
    """Yield a line of the table for each who stands beside ours."""
    ours, *others = sides
    if not others:
        yield f"| {what} | {ours.cell} | | |\n"
    for other in others:
        yield f"| {what} | {ours.cell} | {other.by}: {other.cell} | {digits(other.median / ours.median)} |\n"


def page(works: Works) -> str:
    """Return the page as Markdown."""
    libraries = ", ".join(f"{name} {version(name)}" for name in ("hitchid", *PEERS))
    text = [
        "# Speed, side by side\n\n",
        "Medians [quartiles] of runs on one machine, each side measured in the same run on the same work. "
        "The ratio is the other's median over ours: above one, hitchid is faster.\n\n",
        f"{os.cpu_count()} cores, {platform.system()} on {platform.machine()}, Python "
        f"{platform.python_version()}; {libraries}.\n\n",
        "`make bench` measures all of it and writes this page; `pytest benchmarks/speed -k phase1` measures "
        "one part.\n",
    ]
    for comparison, (title, description) in COMPARISONS.items():
        table = {what: sides for (key, what), sides in works.items() if key == comparison}
        if not table:
            continue
        text += [f"\n## {title}\n\n{description}\n\n", HEADER]
        text += [line for what, sides in table.items() for line in lines(what, sides)]
        notes = dict.fromkeys(
            (what, side.note) for what, sides in table.items() for side in sides if side.note
        )
        text += [f"\n{what}: {note}.\n" for what, note in notes]
    return "".join(text)


def main(calls: Path, timings_file: Path, out: Path) -> None:
    """Write the page from what both files hold; a part that was not measured has none."""
    timed = json.loads(calls.read_text(encoding="utf-8")) if calls.is_file() else {}
    timings = json.loads(timings_file.read_text(encoding="utf-8")) if timings_file.is_file() else []
    works = collect(timed, (Timing(**entry) for entry in timings))
    out.write_text(page(works), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
