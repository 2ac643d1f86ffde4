"""One step at a time: its time, its agreement with a whole simulation, and that memory does not grow.

    python benchmarks/stepping.py MODEL [--steps 100000] [--long 10000000]

The agreement is over random commands of both directions, without measurements; the time with one each sample.
"""

import argparse
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hitchid.model import Hitch, load

HOLD_SAMPLES = 50
WARM_UP = 200


def commands(steps: int, highest: float, seed: int) -> np.ndarray:
    """Return random levels held for half a second each, half of them zero, shape [N, 2]."""
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.0, highest, (-(-steps // HOLD_SAMPLES), 2)) * (
        rng.random((-(-steps // HOLD_SAMPLES), 2)) > 0.5
    )
    return np.repeat(levels, HOLD_SAMPLES, axis=0)[:steps]


def agreement(model: Hitch, steps: int) -> float:
    """Return the largest difference between stepping and `simulate`, in the model's unit."""
    inputs = commands(steps, 0.7, 0)
    inputs[0] = 0.0
    simulated = model.simulate(inputs, step_s=model.step_s, initial=120.0).displacement
    state, largest = model.init_state(120.0), 0.0
    for number in range(steps - 1):
        state, displacement = model.step(state, inputs[number])
        largest = max(largest, abs(float(displacement) - simulated[number + 1]))
    return largest


def times_s(model: Hitch, steps: int, measured: Callable[[int], float | None]) -> np.ndarray:
    """Return the time of each step, from commands in to displacement out."""
    inputs, state, durations_s = commands(steps, 0.7, 1), model.init_state(120.0), np.empty(steps)
    for number in range(steps):
        command, measurement = inputs[number], measured(number)
        started = time.perf_counter()
        state, displacement = model.step(state, command, measurement)
        float(displacement)
        durations_s[number] = time.perf_counter() - started
    return durations_s[WARM_UP:]


def growth_mib(model: Hitch, steps: int) -> float:
    """Return by how much the largest resident size grows over so many steps after a first 10,000."""
    times_s(model, 10_000, lambda number: 120.0)
    memory_before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    inputs, state = commands(HOLD_SAMPLES * 1000, 0.7, 2), model.init_state(120.0)
    for number in range(steps):
        state, _ = model.step(state, inputs[number % len(inputs)], 120.0)
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory_before) / 1024


def main() -> None:
    """Print every figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--long", type=int, default=0)
    arguments = parser.parse_args()
    model = load(arguments.model)
    for name, measured in (("measured", lambda number: 120.0), ("free run", lambda number: None)):
        durations_us = 1e6 * times_s(model, arguments.steps, measured)
        median, percentile_99 = np.percentile(durations_us, [50, 99])
        sys.stdout.write(f"{name}: median {median:.1f} µs, 99th percentile {percentile_99:.1f} µs\n")
    sys.stdout.write(f"largest difference to simulate: {agreement(model, arguments.steps):.3g}\n")
    if arguments.long:
        sys.stdout.write(
            f"memory over {arguments.long} steps: {growth_mib(model, arguments.long):+.1f} MiB\n"
        )


if __name__ == "__main__":
    main()
