"""Hands damaged and hostile files in at every door, and keeps those that anything but a refusal came of.

What may come out of an input: a result, or an error of `hitchid`, within 10 s and 2 GB here and in the
process that reads; of what a checksum guards, no result but that of the whole file. Exits with 1 where
anything else did.

    python benchmarks/fuzz.py [--inputs 20000] [--seed 0] [--only tdms] [--keep FOLDER]
"""

import argparse
import os
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(1, str(Path(__file__).parents[1] / "tests" / "readers"))

import fuzzing
from hitchid.readers import ReaderProcess

EVERY, MOST_MEMORY = 1000, 2**31
ROOM = 4 * 2**30  # what this process may ask for: a fault must not take the machine down


@dataclass
class Found:
    """What has come of the inputs so far."""

    verdicts: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    spent_s: Counter[str] = field(default_factory=Counter)
    slowest: tuple[float, str] = (0.0, "none")
    peak: int = 0
    starts: int = 0
    faults: list[str] = field(default_factory=list)


def main() -> None:
    """Run, and exit with 1 where an input showed a fault."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--inputs", type=int, default=20000)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--first", type=int, default=0, help="number of the first input")
    options.add_argument("--only", default="", help="seeds whose names begin so")
    options.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "hitchid-fuzz")
    asked = options.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")  # libraries warn of what is damaged on every input
    resource.setrlimit(resource.RLIMIT_DATA, (ROOM, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    with tempfile.TemporaryDirectory() as scratch, ReaderProcess() as process:
        found = _run(asked, Path(scratch), process)
    _report(found)
    sys.exit(bool(found.faults))


def _run(asked: argparse.Namespace, scratch: Path, process: ReaderProcess) -> Found:
    every = fuzzing.seeds(scratch / "seeds")
    seeds = [seed for seed in every if seed.name.startswith(asked.only)]
    whole = {}
    for seed in seeds:
        fuzzing.put(scratch / "input", seed.files)
        whole[seed.name] = fuzzing.told_apart(seed.door(scratch / "input", process))
    found, begun, children = Found(), time.monotonic(), set()
    for number in range(asked.first, asked.first + asked.inputs):
        rng = np.random.default_rng([asked.seed, number])
        seed = seeds[int(rng.integers(0, len(seeds)))]
        files = fuzzing.changed(rng, seed, every)
        fuzzing.put(scratch / "input", files)
        before = time.monotonic()
        outcome = fuzzing.tried(seed, scratch / "input", process, whole[seed.name] if seed.sealed else None)
        lasted_s = time.monotonic() - before
        found.spent_s[seed.name] += lasted_s
        found.slowest = max(found.slowest, (lasted_s, f"{seed.name}, input {number}"))
        memory = _memory(children)
        if lasted_s > fuzzing.LONGEST_S and outcome.fault is None:
            outcome = fuzzing.Outcome("fault", f"took {lasted_s:.1f} s")
        if memory > max(found.peak, MOST_MEMORY):
            outcome = fuzzing.Outcome("fault", f"took {memory / 1e9:.2f} GB; {outcome.said}", outcome.fault)
        found.peak, found.starts = max(found.peak, memory), len(children)
        found.verdicts[seed.name][outcome.verdict] += 1
        if outcome.verdict == "fault":
            found.faults.append(_kept(asked, number, seed, files, outcome))
        if (number + 1 - asked.first) % EVERY == 0:
            done, lasted_s = number + 1 - asked.first, time.monotonic() - begun
            _say(
                f"{done} inputs, {done / lasted_s:.0f}/s, {len(found.faults)} faults, {found.starts} starts "
                f"of the reader, slowest {found.slowest[0]:.1f} s, {found.peak / 1e9:.2f} GB"
            )
    return found


def _memory(children: set[int]) -> int:
    """Return the most memory this process or the one that reads has had, bytes; note which there were."""
    peak = 1024 * max(
        resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    own = os.getpid()
    for child in map(int, Path(f"/proc/{own}/task/{own}/children").read_text().split()):
        children.add(child)
        try:
            status = Path(f"/proc/{child}/status").read_text()
        except OSError:
            continue
        held = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
        peak = max([peak, *(1024 * int(each) for each in held)])
    return peak


def _kept(
    asked: argparse.Namespace, number: int, seed: fuzzing.Seed, files: fuzzing.Files, outcome: fuzzing.Outcome
) -> str:
    """Keep an input that shows a fault, and what came of it; return both in one line."""
    place = asked.keep / f"{seed.name.replace(' ', '-')}-{asked.seed}-{number}"
    fuzzing.put(place, files)
    told = [] if outcome.fault is None else traceback.format_exception(outcome.fault)
    (place / "fault.txt").write_text("".join([outcome.said, "\n", *told]), errors="backslashreplace")
    line = f"{seed.name}, input {number}: {outcome.said}; kept in {place}"
    _say(line)
    return line


def _report(found: Found) -> None:
    _say(f"{'':20}{'inputs':>8}{'refused':>9}{'accepted':>10}{'fault':>7}{'ms each':>9}")
    for name, verdicts in sorted(found.verdicts.items()):
        count = verdicts.total()
        cells = (verdicts[fuzzing.REFUSED], verdicts[fuzzing.ACCEPTED], verdicts["fault"])
        _say(
            f"{name:20}{count:8}{cells[0]:9}{cells[1]:10}{cells[2]:7}{1e3 * found.spent_s[name] / count:9.1f}"
        )
    _say(f"slowest: {found.slowest[0]:.2f} s, {found.slowest[1]}")
    _say(f"most memory: {found.peak / 1e9:.2f} GB; the reader was started {found.starts} times")
    _say(f"faults: {len(found.faults)}")
    for line in found.faults:
        _say(f"  {line}")


def _say(line: str) -> None:
    sys.stdout.write(line.encode(errors="backslashreplace").decode() + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
