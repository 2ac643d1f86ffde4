"""Made-up logs of a two-way plant."""

import shutil
from pathlib import Path

import numpy as np

from hitchid.logs import write_table


def binary_command(rng: np.random.Generator, samples: int, low: float, high: float) -> np.ndarray:
    """Return a random binary command, shape [N], that holds a level for 0.2 to 1 s at 100 Hz, after rest."""
    holds = rng.integers(20, 100, samples // 20)
    levels = rng.choice([low, high], holds.size)
    return np.concatenate([np.zeros(5), np.repeat(levels, holds)])[:samples]


def lagged_integrator(
    command: np.ndarray, *, gain: float, time_constant: float, dead_zone: float, step_s: float = 0.01
) -> np.ndarray:
    """Return the travel of K/(s(τs+1)) behind a dead zone, by its closed-form step from sample to sample."""
    decay = np.exp(-step_s / time_constant)
    travel = np.zeros(command.size)
    speed = 0.0
    for k, effective in enumerate(np.maximum(command - dead_zone, 0.0)[:-1]):
        final = gain * effective
        travel[k + 1] = travel[k] + final * step_s + (speed - final) * time_constant * (1 - decay)
        speed = final + (speed - final) * decay
    return travel


def write_bench(
    place: Path, *, tests: int = 5, samples: int = 400, noise: float = 0.02, seed: int = 0
) -> Path:
    """Write a folder of made-up logs of a two-way plant and return it."""
    rng = np.random.default_rng(seed)
    place.mkdir()
    time_s = 0.01 * np.arange(samples)
    for mode, direction, start in (("lifting", 1, 0.0), ("lowering", -1, 200.0)):
        for number in range(1, tests + 1):
            command = binary_command(rng, samples, 0.45, rng.uniform(0.5, 0.7))
            travel = lagged_integrator(command, gain=30.0, time_constant=0.08, dead_zone=0.35)
            measured = start + direction * travel + noise * rng.standard_normal(samples)
            up, down = (command, 0 * command) if direction > 0 else (0 * command, command)
            write_table(
                place / f"{mode}-{number:02d}.csv",
                {
                    "time_s": np.round(time_s, 4),
                    "current_up_A": up,
                    "current_down_A": down,
                    "displacement_mm": measured,
                },
            )
    return place


def with_a_cycle(folder: Path, place: Path) -> Path:
    """Return a copy of a folder of logs with one that goes up for a second and down for a second."""
    logs = shutil.copytree(folder, place)
    up, down = np.repeat([0, 0.6, 0, 0], 100), np.repeat([0, 0, 0, 0.6], 100)
    columns = {
        "time_s": np.round(0.01 * np.arange(400), 4),
        "current_up_A": up,
        "current_down_A": down,
        "displacement_mm": 100 + np.cumsum(0.07 * (up > 0) - 0.05 * (down > 0)),
    }
    write_table(logs / "cycle-01.csv", columns)
    return logs
