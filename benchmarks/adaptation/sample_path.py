"""Time of a sample while the model adapts: the update runs in another process and must not delay it."""

import json
import time

import numpy as np
from benchmarks.adaptation.bench import at_work, nominal
from benchmarks.adaptation.figure import Figure
from benchmarks.scheduling import show

from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.online import Live, OnlineAdaptation

DURATION_S = 180.0  # at the speed of the machine
SAMPLE_S = 1e-3  # bar of the 99th percentile


def sample_path() -> list[Figure]:
    """Return the time of a sample at 100 Hz, from the line of JSON to the output, with updates between."""
    model = nominal()
    record = at_work("nominal", model, 31, DURATION_S).record
    columns = {COMMAND[direction]: record.command(direction) for direction in DIRECTIONS}
    columns[DISPLACEMENT] = record.displacement
    adaptation = OnlineAdaptation(model)
    live, took_s = Live(model, adaptation=adaptation), []
    begun_s = time.perf_counter()
    for number in range(len(record)):
        values = {name: float(values[number]) for name, values in columns.items()}
        line = json.dumps({"time_s": number * model.step_s, **values})
        time.sleep(max(0.0, begun_s + number * model.step_s - time.perf_counter()))
        started_s = time.perf_counter()
        live.process(line)
        took_s.append(time.perf_counter() - started_s)
    events = adaptation.finish()
    p50, p99, longest = np.quantile(took_s, [0.5, 0.99, 1.0])
    show(
        f"sample path: {len(took_s)} samples, median {1e6 * p50:.0f} µs, longest {1e3 * longest:.1f} ms, "
        f"{adaptation.changes}; {len(events)} events at the end"
    )
    return [Figure("sample path, p99, s", float(p99), most=SAMPLE_S)]
