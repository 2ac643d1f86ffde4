"""Whole programs, from start to end, beside a peer's import or the time the paper gives."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from timings import OURS, environment, process

HITCHID = Path(sys.executable).with_name("hitchid")
IMPORT_TORCH = 'python -c "import torch"'
PAPER, PAPER_S = "training alone in the paper", 600.0
SAMPLE = '{"time_s": 0.0, "lifting_command": 0.5, "lowering_command": 0.0, "displacement": 100.0}\n'
SHORT = """[lifting]
structure = "integrator-second-order"
[lowering]
structure = "first-order-lag"
[search]
evaluations = 300
compare = false
[training]
epochs = 5
free_run = false
baselines = false
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> Path:
    """Return a folder that stands for the user's cache."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def identified(cache, rig_a, pace, tmp_path_factory) -> tuple[list[str | Path], Path]:
    """Return a command that identifies rig-a and the model it made, its programs compiled."""
    folder = tmp_path_factory.mktemp("model")
    command: list[str | Path] = [HITCHID, "identify", rig_a, "--out", folder / "model", "--quiet"]
    if pace.quick:
        (folder / "short.toml").write_text(SHORT)
        command += ["--config", folder / "short.toml"]
    process(command, cache)
    return [*command, "--force"], folder / "model"


def import_torch() -> None:
    """Start Python and import the library that a model of a peer would need."""
    process([sys.executable, "-c", "import torch"])


def test_help(tally, cache, pace):
    """The shortest thing that the program can do."""
    work = {OURS: lambda: process([HITCHID, "--help"], cache), IMPORT_TORCH: import_torch}
    for do in work.values():
        do()
    tally.interleave("`hitchid --help`", work, pace.runs)


def test_identify(tally, cache, identified, pace):
    """A whole identification, its programs compiled before, no search kept from the run before."""
    command, _ = identified

    def run() -> float:
        shutil.rmtree(cache / "hitchid" / "searches", ignore_errors=True)
        return seconds(command, cache)

    tally.interleave("`hitchid identify` on rig-a, compiled before", {OURS: run}, pace.slow_runs)
    tally.note("`hitchid identify` on rig-a, compiled before", {PAPER: [PAPER_S]})


def test_validate(tally, cache, identified, rig_a, pace, tmp_path):
    """A whole validation with its report, its programs compiled before."""
    command = [HITCHID, "validate", identified[1], rig_a, "--out", tmp_path / "out"]
    process(command, cache)
    again = [*command, "--force"]
    tally.interleave(
        "`hitchid validate` on rig-a, compiled before", {OURS: lambda: seconds(again, cache)}, pace.slow_runs
    )


def test_first_step(tally, cache, identified, pace):
    """From the start of `hitchid run` to its answer to the first sample."""
    command = [HITCHID, "run", identified[1]]
    first_step_s(command, cache)
    work = {OURS: lambda: first_step_s(command, cache), IMPORT_TORCH: import_torch}
    tally.interleave(
        "`hitchid run`, from start to its first answer", work, pace.runs, "the peer's import alone"
    )


@pytest.mark.parametrize("compiled", [False, True])
def test_reproduce(tally, pace, tmp_path, compiled):
    """The whole study, with an empty cache and with its programs compiled before."""
    command = [
        HITCHID,
        "reproduce",
        "--out",
        tmp_path / "study",
        "--force",
        *(["--quick"] if pace.quick else []),
    ]
    cache = tmp_path / "cache"
    if compiled:
        process(command, cache)

    def run() -> float:
        shutil.rmtree(cache if not compiled else cache / "hitchid" / "searches", ignore_errors=True)
        return seconds(command, cache)

    what = f"`hitchid reproduce`, {'compiled before' if compiled else 'from an empty cache'}"
    tally.interleave(what, {OURS: run}, pace.slow_runs)
    tally.note(what, {PAPER: [PAPER_S]}, "ours with virtual bench, validation, figures and tables")


def seconds(command: list[str | Path], cache: Path) -> float:
    """Return the seconds that a program takes."""
    started = time.perf_counter()
    process(command, cache)
    return time.perf_counter() - started


def first_step_s(command: list[str | Path], cache: Path) -> float:
    """Return the seconds until a program answers its first line."""
    started = time.perf_counter()
    with subprocess.Popen(  # noqa: S603
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment(cache)
    ) as running:
        running.stdin.write(SAMPLE)
        running.stdin.flush()
        answer = running.stdout.readline()
        elapsed_s = time.perf_counter() - started
        running.stdin.close()
    if "displacement" not in answer:
        raise RuntimeError(f"{' '.join(map(str, command))}: no answer")
    return elapsed_s
