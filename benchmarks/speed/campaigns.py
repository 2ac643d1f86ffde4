"""Logs of many made-up linear plants, no two alike."""

from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

from hitchid.logs import write_table

TESTS, SAMPLES, STEP_S = 10, 1001, 0.01
DEAD_ZONE, NOISE_MM = 0.35, 0.05
TOP_MM = 250.0


def write_campaigns(root: Path, number: int, seed: int = 0) -> list[Path]:
    """Write a folder of logs for each of many plants: ten tests of ten seconds a direction."""
    rng = np.random.default_rng(seed)
    folders = [root / f"plant-{plant:02d}" for plant in range(number)]
    for folder in folders:
        folder.mkdir(parents=True)
        lifting = [rng.uniform(15, 25)], [1 / 18**2, 3.6 / 18, 1.0, 0.0]
        lowering = [rng.uniform(600, 900)], [rng.uniform(35, 50), 1.0]
        for test in range(1, TESTS + 1):
            up, down = _command(rng), _command(rng)
            _write(folder / f"lifting-{test:02d}.csv", up, 0 * up, _measured(rng, _travel(lifting, up)))
            lowered = TOP_MM - _travel(lowering, down)
            _write(folder / f"lowering-{test:02d}.csv", 0 * down, down, _measured(rng, lowered))
    return folders


def _command(rng: np.random.Generator) -> np.ndarray:
    """Return random levels held for 0.2 to 1 s after rest, shape [N]."""
    holds = rng.integers(20, 100, SAMPLES // 20)
    levels = rng.choice([0.45, rng.uniform(0.5, 0.7)], holds.size)
    return np.concatenate([np.zeros(5), np.repeat(levels, holds)])[:SAMPLES]


def _travel(plant: tuple[list[float], list[float]], command: np.ndarray) -> np.ndarray:
    """Return the travel of a linear plant behind a dead zone, mm, shape [N]."""
    numerator, denominator, _ = cont2discrete(plant, STEP_S, method="zoh")
    return lfilter(numerator[0], denominator, np.maximum(command - DEAD_ZONE, 0.0))


def _measured(rng: np.random.Generator, displacement: np.ndarray) -> np.ndarray:
    return displacement + NOISE_MM * rng.standard_normal(displacement.size)


def _write(path: Path, up: np.ndarray, down: np.ndarray, displacement: np.ndarray) -> None:
    columns = {"time_s": np.round(STEP_S * np.arange(SAMPLES), 4), "current_up_A": up, "current_down_A": down}
    write_table(path, {**columns, "displacement_mm": displacement})
