"""Commands as benches, operators and controllers give them: shares of full scale, positive lifts."""

from collections.abc import Callable

import numpy as np

Rng = np.random.Generator
Levels = tuple[float, float]


def steps(rng: Rng, samples: int, levels: Levels) -> np.ndarray:
    """Return two to six levels after each other, with a rest between some."""
    count = int(rng.integers(2, 7))
    heights = rng.uniform(*levels, count) * (rng.random(count) > 0.25)
    return np.repeat(heights, -(-samples // count))[:samples]


def ramp(rng: Rng, samples: int, levels: Levels) -> np.ndarray:
    """Return a rise from zero to the highest level."""
    return np.linspace(0.0, rng.uniform(0.8, 1.0) * levels[1], samples)


def prbs(rng: Rng, samples: int, levels: Levels) -> np.ndarray:
    """Return a random binary sequence between two levels, or between one and rest."""
    hold = max(2, samples // int(rng.integers(8, 40)))
    low = rng.choice([0.0, levels[0]])
    values = rng.choice([low, rng.uniform(*levels)], -(-samples // hold))
    return np.repeat(values, hold)[:samples]


def sine(rng: Rng, samples: int, levels: Levels) -> np.ndarray:
    """Return a sine about the middle of the levels, one to eight periods."""
    phase = np.linspace(0.0, 2 * np.pi * rng.uniform(1, 8), samples)
    return np.mean(levels) + 0.5 * np.ptp(levels) * np.sin(phase)


def operator(rng: Rng, samples: int, levels: Levels) -> np.ndarray:
    """Return strokes of a joystick: smooth rises, uneven holds, rests between."""
    raw = np.zeros(samples)
    position = 0
    while position < samples:
        hold = int(samples * rng.uniform(0.03, 0.2)) + 1
        raw[position : position + hold] = rng.uniform(*levels)
        position += hold + int(samples * rng.uniform(0.02, 0.15)) + 1
    width = max(1, samples // 100)
    return np.convolve(raw, np.ones(width) / width, mode="same")


def one_level(rng: Rng, samples: int, levels: Levels) -> np.ndarray:
    """Return one level, held from soon after the start to near the end."""
    command = np.full(samples, float(np.mean(levels)))
    command[: max(2, samples // 20)] = 0.0
    command[samples - samples // 10 :] = 0.0
    return command


SHAPES: dict[str, Callable[[Rng, int, Levels], np.ndarray]] = {
    "steps": steps,
    "ramp": ramp,
    "PRBS": prbs,
    "sine": sine,
    "operator": operator,
    "one level": one_level,
}


def start_at_rest(command: np.ndarray) -> np.ndarray:
    """Return a command that is zero over its first samples: every test begins at rest."""
    return np.where(np.arange(command.size) < max(2, command.size // 50), 0.0, command)


def alternating(rng: Rng, samples: int, levels: Levels, shape: str) -> np.ndarray:
    """Return strokes up and down in turn, each of one shape, with rests between."""
    strokes = int(rng.integers(2, 9))
    length = max(8, samples // strokes)
    segments = []
    for number in range(-(-samples // length)):
        segment = SHAPES[shape](rng, length, levels) * (1 if number % 2 == 0 else -1)
        segment[length - length // 4 :] = 0.0
        segments.append(segment)
    return np.concatenate(segments)[:samples]
