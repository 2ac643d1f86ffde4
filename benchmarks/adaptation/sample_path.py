"""Time of a sample while the model adapts: the update runs in another process and must not delay it.

Before each sample the latest one is rehearsed, after its output it is learned from, as `hitchid run` does.
"""

import json
import time

import numpy as np
from benchmarks.adaptation.bench import at_work, nominal
from benchmarks.adaptation.figure import Figure
from benchmarks.scheduling import show

from hitchid.cli.run import REHEARSAL_S
from hitchid.live import Live, OnlineAdaptation
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT, Record

DURATION_S = 60.0  # at the speed of the machine
SAMPLE_S = 1e-3  # bar of the 99th percentile


def sample_path() -> list[Figure]:
    """Return the time of a sample at 100 Hz, from the line of JSON to the output, with updates between."""
    model = nominal()
    record = at_work("nominal", model, 31, DURATION_S).record
    frozen_s = seconds(Live(model), record)
    adaptation = OnlineAdaptation(model)
    adapted_s = seconds(Live(model, adaptation=adaptation), record)
    adaptation.finish()
    for name, took_s in (("frozen", frozen_s), ("adapted", adapted_s)):
        median, late = 1e3 * np.quantile(took_s, [0.5, 0.99])
        show(f"sample path, {name}: {took_s.size} samples, median {median:.2f} ms, p99 {late:.2f} ms")
    return [Figure("sample path, p99, s", float(np.quantile(adapted_s, 0.99)), most=SAMPLE_S)]


def seconds(live: Live, record: Record) -> np.ndarray:
    """Return how long each sample of a record takes, at the speed of the machine, s."""
    columns = {COMMAND[direction]: record.command(direction) for direction in DIRECTIONS}
    columns[DISPLACEMENT] = record.displacement
    took_s, begun_s = [], time.perf_counter()
    for number in range(len(record)):
        values = {name: float(values[number]) for name, values in columns.items()}
        line = json.dumps({"time_s": number * record.step_s, **values})
        due_s = begun_s + number * record.step_s
        _sleep_until(due_s - REHEARSAL_S)
        live.rehearse()
        overrun = time.perf_counter() > due_s  # of learning or of the rehearsal: the sample had to wait
        _sleep_until(due_s)
        started_s = due_s if overrun else time.perf_counter()
        live.process(line)
        took_s.append(time.perf_counter() - started_s)
        live.learn()
    return np.array(took_s)


def _sleep_until(time_s: float) -> None:
    time.sleep(max(0.0, time_s - time.perf_counter()))
