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

jax.config.update("jax_enable_x64", True)  # before models are made by hand
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(1, str(Path(__file__).parents[1] / "tests" / "logs"))

import fuzzing  # noqa: E402
from hitchid.logs import ReaderProcess  # noqa: E402

REPORT_INTERVAL, MOST_MEMORY = 1000, 2**31
MEMORY_LIMIT = 4 * 2**30  # what this process may ask for: a fault must not take the machine down


@dataclass
class FuzzStatistics:
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
    options.add_argument("--only", nargs="+", default=[""], help="seeds whose names begin so")
    options.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "hitchid-fuzz")
    arguments = options.parse_args()
    warnings.simplefilter("ignore")  # libraries warn of what is damaged on every input
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_LIMIT, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    with tempfile.TemporaryDirectory() as scratch, ReaderProcess() as process:
        statistics = _run(arguments, Path(scratch), process)
    _report(statistics)
    sys.exit(bool(statistics.faults))


def _run(arguments: argparse.Namespace, scratch: Path, process: ReaderProcess) -> FuzzStatistics:
    all_seeds = fuzzing.seeds(scratch / "seeds")
    seeds = [seed for seed in all_seeds if seed.name.startswith(tuple(arguments.only))]
    undamaged = {}
    for seed in seeds:
        fuzzing.put(scratch / "input", seed.files)
        undamaged[seed.name] = fuzzing.told_apart(seed.door(scratch / "input", process))
    statistics, started, children = FuzzStatistics(), time.monotonic(), set()
    for number in range(arguments.first, arguments.first + arguments.inputs):
        rng = np.random.default_rng([arguments.seed, number])
        seed = seeds[int(rng.integers(0, len(seeds)))]
        files = fuzzing.changed(rng, seed, all_seeds)
        fuzzing.put(scratch / "input", files)
        input_started = time.monotonic()
        outcome = fuzzing.tried(
            seed, scratch / "input", process, undamaged[seed.name] if seed.sealed else None
        )
        duration_s = time.monotonic() - input_started
        statistics.spent_s[seed.name] += duration_s
        statistics.slowest = max(statistics.slowest, (duration_s, f"{seed.name}, input {number}"))
        memory = _memory(children)
        if duration_s > fuzzing.LONGEST_S and outcome.fault is None:
            outcome = fuzzing.Outcome("fault", f"took {duration_s:.1f} s")
        if memory > max(statistics.peak, MOST_MEMORY):
            outcome = fuzzing.Outcome("fault", f"took {memory / 1e9:.2f} GB; {outcome.said}", outcome.fault)
        statistics.peak, statistics.starts = max(statistics.peak, memory), len(children)
        statistics.verdicts[seed.name][outcome.verdict] += 1
        if outcome.verdict == "fault":
            statistics.faults.append(_save_fault(arguments, number, seed, files, outcome))
        if (number + 1 - arguments.first) % REPORT_INTERVAL == 0:
            input_count, duration_s = number + 1 - arguments.first, time.monotonic() - started
            _say(
                f"{input_count} inputs, {input_count / duration_s:.0f}/s, {len(statistics.faults)} faults, "
                f"{statistics.starts} starts "
                f"of the reader, slowest {statistics.slowest[0]:.1f} s, {statistics.peak / 1e9:.2f} GB"
            )
    return statistics


def _memory(children: set[int]) -> int:
    """Return the most memory this process or the one that reads has had, bytes; note which there were."""
    peak = 1024 * max(
        resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    process_id = os.getpid()
    for child in map(int, Path(f"/proc/{process_id}/task/{process_id}/children").read_text().split()):
        children.add(child)
        try:
            status = Path(f"/proc/{child}/status").read_text()
        except OSError:
            continue
        peak_lines = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
        peak = max([peak, *(1024 * int(kilobytes) for kilobytes in peak_lines)])
    return peak


def _save_fault(
    arguments: argparse.Namespace,
    number: int,
    seed: fuzzing.Seed,
    files: fuzzing.Files,
    outcome: fuzzing.Outcome,
) -> str:
    """Keep an input that shows a fault, and what came of it; return both in one line."""
    folder = arguments.keep / f"{seed.name.replace(' ', '-')}-{arguments.seed}-{number}"
    fuzzing.put(folder, files)
    traceback_lines = [] if outcome.fault is None else traceback.format_exception(outcome.fault)
    (folder / "fault.txt").write_text(
        "".join([outcome.said, "\n", *traceback_lines]), errors="backslashreplace"
    )
    line = f"{seed.name}, input {number}: {outcome.said}; kept in {folder}"
    _say(line)
    return line


def _report(statistics: FuzzStatistics) -> None:
    _say(f"{'':20}{'inputs':>8}{'refused':>9}{'accepted':>10}{'fault':>7}{'ms each':>9}")
    for name, verdicts in sorted(statistics.verdicts.items()):
        count = verdicts.total()
        cells = (verdicts[fuzzing.REFUSED], verdicts[fuzzing.ACCEPTED], verdicts["fault"])
        _say(
            f"{name:20}{count:8}{cells[0]:9}{cells[1]:10}{cells[2]:7}"
            f"{1e3 * statistics.spent_s[name] / count:9.1f}"
        )
    _say(f"slowest: {statistics.slowest[0]:.2f} s, {statistics.slowest[1]}")
    _say(f"most memory: {statistics.peak / 1e9:.2f} GB; the reader was started {statistics.starts} times")
    _say(f"faults: {len(statistics.faults)}")
    for line in statistics.faults:
        _say(f"  {line}")


def _say(line: str) -> None:
    sys.stdout.write(line.encode(errors="backslashreplace").decode() + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
