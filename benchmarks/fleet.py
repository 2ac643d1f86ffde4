"""A fleet on the virtual bench: equal models for any runner, killed workers, rerun, memory, speed-up.

Run: python -m benchmarks.fleet quick
     python -m benchmarks.fleet [same] [killed] [study MACHINES]
"""

import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from benchmarks.scheduling import show

from hitchid.bench.virtual_campaign import Conditions, write_campaign
from hitchid.fleet import FleetResult, Row, Runner, Store, identify_fleet, read_rows
from hitchid.fleet.jobs import identification_job
from hitchid.fleet.runners import run_local
from hitchid.fleet.store import machines_of
from hitchid.identification import MultiStart, Settings

MACHINES = 24  # that runners are compared on
TESTS = 5  # of a direction, of which one is held out
RERUN_S = 5.0  # largest time of a run that has nothing to do
SPEEDUP = 1.7  # smallest gain of two workers over one, on two cores
WORKER_BYTES = 1.5e9  # largest memory of a worker
KILL_EVERY_S, KILLING_S = 30.0, 600.0  # between two kills, and of the whole study of them
SETTINGS: Settings = {
    "structure": {"lifting": "integrator-second-order", "lowering": "integrator-first-order"},
    "search": MultiStart(evaluations=200),
    "training": None,
    "rivals": None,
}


@dataclass(frozen=True)
class Missed:
    """A figure that misses its bar."""

    sentence: str


def write_machines(folder: Path, count: int) -> Path:
    """Write the logs of machines that differ by load, oil and noise; return the folder of all."""
    rng = np.random.default_rng(0)
    for number in range(count):
        conditions = Conditions((rng.uniform(800.0, 1200.0),), (rng.uniform(30.0, 50.0),))
        name = folder / f"tractor-{number:04d}"
        write_campaign(name, "nominal", tests={"prbs": TESTS}, conditions=conditions, seed=number)
    return folder


def model_files(results: Path) -> dict[str, bytes]:
    """Return path to content of all files of all models."""
    models = results / "models"
    return {
        path.relative_to(models).as_posix(): path.read_bytes() for path in models.rglob("*") if path.is_file()
    }


def timed(logs: Path, results: Path, runner: Runner) -> tuple[FleetResult[Row], float]:
    """Return the result of an identification, and how long it took, s."""
    started_s = time.perf_counter()
    result = identify_fleet(str(logs), str(results), settings=SETTINGS, runner=runner)
    return result, time.perf_counter() - started_s


def same(count: int, runners: Sequence[Runner]) -> Iterator[Missed]:
    """Identify a fleet with each runner; yield where models differ, or a rerun works."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        logs, first = write_machines(folder / "logs", count), None
        timed(write_machines(folder / "warm", 2), folder / "results", runners[0])  # compiles, for all alike
        seconds = {}
        for number, runner in enumerate(runners):
            results = folder / f"results-{number}"
            result, took_s = timed(logs, results, runner)
            name = f"{runner.name}, {runner.workers} workers"
            seconds[runner.name, runner.workers] = took_s
            show(f"{name}: {count} machines in {took_s:.0f} s, {dict(result.counts)}")
            if result.worked != count or result.counts["done"] != count:
                yield Missed(f"{name}: {result.worked} of {count} machines identified: {result.failures}")
            models = model_files(results)
            first = first or models
            if models != first:
                yield Missed(f"{name}: models differ from those of the first runner")
        again, rerun_s = timed(logs, folder / "results-0", runners[0])
        show(f"rerun: {again.worked} identified in {rerun_s:.1f} s")
        if again.worked or rerun_s > RERUN_S:
            yield Missed(
                f"rerun: {again.worked} identified in {rerun_s:.1f} s, expected none in {RERUN_S:g} s"
            )
        if ("local", 1) in seconds and ("local", 2) in seconds and len(os.sched_getaffinity(0)) > 1:
            ratio = seconds["local", 1] / seconds["local", 2]
            show(f"two workers: {ratio:.2f} times as fast as one")
            if ratio < SPEEDUP:
                yield Missed(f"two workers: {ratio:.2f} times as fast as one, expected {SPEEDUP:g}")


def killed() -> Iterator[Missed]:
    """Kill a worker every 30 s for ten minutes; yield what was lost, and reruns beyond one a kill."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        logs = write_machines(folder / "logs", 150)
        job = identification_job(str(logs), str(folder / "results"), SETTINGS)
        rng, kills, next_s, begin_s = np.random.default_rng(0), 0, KILL_EVERY_S, time.perf_counter()
        acknowledgements = []
        machines = machines_of(job.logs)
        for acknowledgement in run_local(job, machines, 2):
            acknowledgements.append(acknowledgement)
            elapsed_s = time.perf_counter() - begin_s
            children = multiprocessing.active_children()
            if next_s < elapsed_s < KILLING_S and children:
                os.kill(children[rng.integers(len(children))].pid or 0, signal.SIGKILL)
                kills, next_s = kills + 1, elapsed_s + KILL_EVERY_S
        done = [row for row in read_rows(Store(str(folder / "results"))) if row.state == "done"]
        took_s = time.perf_counter() - begin_s
        show(f"{kills} kills in {took_s:.0f} s: {len(done)} of {len(machines)} machines done")
        if len(done) != len(machines) or len(acknowledgements) != len(machines):
            yield Missed(f"{len(machines) - len(done)} machines lost after {kills} kills")


def study(count: int) -> Iterator[Missed]:
    """Identify many machines once; show what a machine takes."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        logs = write_machines(folder / "logs", count)
        result, took_s = timed(logs, folder / "results", Runner(workers=2))
        costs = [row.cost for row in result.rows if row.cost is not None]
        mean = {name: sum(getattr(cost, name) for cost in costs) / len(costs) for name in vars(costs[0])}
        show(
            f"{count} machines in {took_s:.0f} s: {dict(result.counts)}; a machine takes "
            f"{mean['core_seconds']:.2f} core-seconds, reads {mean['bytes_read'] / 1e3:.0f} kB, writes "
            f"{mean['bytes_written'] / 1e3:.0f} kB; largest memory of a worker "
            f"{max(cost.peak_bytes for cost in costs) / 1e9:.2f} GB"
        )
        again, rerun_s = timed(logs, folder / "results", Runner(workers=2))
        show(f"rerun of {count}: {again.worked} identified in {rerun_s:.1f} s")
        if again.worked or rerun_s > RERUN_S:
            yield Missed(f"rerun of {count}: {rerun_s:.1f} s, expected {RERUN_S:g}")
        largest = max(cost.peak_bytes for cost in costs)
        if largest > WORKER_BYTES:
            yield Missed(
                f"{largest / 1e9:.2f} GB of memory of a worker, expected at most {WORKER_BYTES / 1e9:g}"
            )


def main(parts: Sequence[str]) -> None:
    """Run parts by name; `same` and `killed` by default."""
    two = (Runner(workers=2), Runner("dask", 2))
    missed: list[Missed] = []
    if "quick" in parts:
        missed += same(MACHINES, two)
    if not parts or "same" in parts:
        missed += same(MACHINES, (*two, Runner(workers=1), replace(two[1], workers=1)))
    if not parts or "killed" in parts:
        missed += killed()
    if "study" in parts:
        missed += study(int(parts[parts.index("study") + 1]))
    if missed:
        sys.exit("\n".join(f"fleet: {each.sentence}" for each in missed))


if __name__ == "__main__":
    main(sys.argv[1:])
