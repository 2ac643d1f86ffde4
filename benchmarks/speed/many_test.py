"""Sixty-four campaigns identified together, beside a process for each of them."""

import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from campaigns import write_campaigns
from timings import OURS, process

CAMPAIGNS, SAMPLED = 64, 6
SCRIPT = Path(__file__).with_name("identify_process.py")
SEPARATE_PROCESSES = "a process for each, as many at a time as there are cores"


@pytest.mark.parametrize("options", [(), ("--physics",)], ids=["whole", "physics alone"])
def test_many(options, tally, pace, tmp_path):
    """Both as whole processes that read their logs, programs compiled before, with the same options."""
    count, sampled = (3, 2) if pace.quick else (CAMPAIGNS, CAMPAIGNS if pace.full else SAMPLED)
    folders, cache = write_campaigns(tmp_path / "logs", count), tmp_path / "cache"
    command = [sys.executable, SCRIPT, *options]
    joint_errors = json.loads(process([*command, *folders[:2]], cache))  # compiles
    (single_errors,) = json.loads(process([*command, folders[0]], cache))
    same = [
        [errors[direction] for direction in sorted(errors)] for errors in (joint_errors[0], single_errors)
    ]
    np.testing.assert_allclose(*same, rtol=1e-3)
    runs, numbers = pace.slow_runs, iter(np.random.default_rng(0).permutation(count).tolist() * pace.runs)

    def separate_processes() -> float:
        commands = [[*command, folders[next(numbers)]] for _ in range(sampled)]
        return _together_s(commands, cache) * count / sampled

    work = {
        OURS: lambda: process([*command, *folders], cache),
        SEPARATE_PROCESSES: separate_processes,
    }
    scaled = (
        ""
        if sampled == count
        else f"processes: {sampled} of them, their time multiplied by {count / sampled:.4g}"
    )
    what = "read and identified without compensators" if options else "read and identified"
    tally.interleave(f"{count} campaigns of 20 tests, {what}", work, runs, scaled)


def _together_s(commands: Sequence[Sequence[str | Path]], cache: Path) -> float:
    """Return the seconds that processes take, as many at a time as there are cores."""
    started = time.perf_counter()
    with ThreadPoolExecutor(os.cpu_count()) as cores:
        list(cores.map(lambda command: process(command, cache), commands))
    return time.perf_counter() - started
