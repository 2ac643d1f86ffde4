"""What the tests compare with: simulations and plants by scipy and closed forms, nothing of the package."""

import numpy as np
from scipy import signal

STEP_S = 0.01


def held(
    numerator: list[float], denominator: list[float], command: np.ndarray, step_s: float = STEP_S
) -> np.ndarray:
    """Return the response from rest of a transfer function to a command held between samples, shape [N]."""
    system = signal.cont2discrete(signal.tf2ss(numerator, denominator), step_s, method="zoh")
    return np.ravel(signal.dlsim(system, command)[1])


def shifted(samples: np.ndarray, count: int) -> np.ndarray:
    """Return samples moved back by some places, zeros before them, shape [N]."""
    return np.concatenate([np.zeros(count), samples])[: samples.size]


def second_order(gain: float, omega: float, damping: float) -> tuple[list[float], list[float]]:
    """Return K / (s (s²/ωh² + 2 ξh s/ωh + 1)) of method.md sec. 2."""
    return [gain], [1 / omega**2, 2 * damping / omega, 1.0, 0.0]


def lag(gain: float, time_constant: float) -> tuple[list[float], list[float]]:
    """Return K / (τ s + 1) with the initial speed per command K/τ as gain."""
    return [gain * time_constant], [time_constant, 1.0]


def levels(rng: np.random.Generator, samples: int, *, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """Return a command that rests five samples, then holds random levels for 10 to 40 samples, shape [N]."""
    holds = rng.integers(10, 40, samples)
    steps = np.repeat(rng.uniform(low, high, samples), holds)[: samples - 5]
    return np.concatenate([np.zeros(5), steps])
