"""Measure the parts named on the command line, and end with exit code 1 where a figure misses its bar."""

import sys
from collections.abc import Callable, Mapping, Sequence

from benchmarks.adaptation.changing import bands, delay, follow
from benchmarks.adaptation.constant import stable, standstill
from benchmarks.adaptation.faults import faults
from benchmarks.adaptation.figure import Figure
from benchmarks.adaptation.measured import measured
from benchmarks.adaptation.sample_path import sample_path
from benchmarks.scheduling import show

Parts = Mapping[str, Callable[[], Sequence[Figure]]]
PARTS: Parts = {
    "follow": follow,
    "stable": stable,
    "faults": faults,
    "bands": bands,
    "standstill": standstill,
    "delay": delay,
    "samples": sample_path,
    "measured": measured,
}
QUICK: Parts = {"quick": lambda: follow(("nominal",), (450.0,), oil=False)}


def main(
    names: Sequence[str], parts: Parts = PARTS | QUICK, everything: Sequence[str] = tuple(PARTS)
) -> None:
    """Run parts by name, all but the quick one by default; exit with the figures that miss their bars."""
    unknown = set(names) - set(parts)
    if unknown:
        sys.exit(f"adaptation: got {', '.join(sorted(unknown))}, expected names out of {', '.join(parts)}")
    missed = []
    for name in names or everything:
        for figure in parts[name]():
            show(str(figure))
            missed += [] if figure.holds else [figure]
    if missed:
        sys.exit("\n".join(["", "Missed:", *map(str, missed)]))


if __name__ == "__main__":
    main(sys.argv[1:])
