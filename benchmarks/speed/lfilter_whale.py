"""The peer of phase 1: mealpy's whales over an objective on `scipy.signal.lfilter`, nothing of ours in it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter
from threadpoolctl import threadpool_limits

MEALPY = "mealpy OriginalWOA, lfilter"


@dataclass(frozen=True)
class Lifting:
    """Lifting tests and the error of an integrator with second-order lag over them.

    Attributes:
        command: effective command, shape [T, N].
        travel: measured, shape [T, N].
        counted: which samples count, shape [T, N].
        bounds: lower and upper, of gain, natural frequency and damping ratio, shape [2, 3].
        step_s: sampling time, s.
    """

    command: np.ndarray
    travel: np.ndarray
    counted: np.ndarray
    bounds: np.ndarray
    step_s: float

    @classmethod
    def load(cls, path: Path) -> "Lifting":
        """Read what `np.savez` wrote under the attributes' names, without padding."""
        with np.load(path) as archive:
            longest = int(archive["counted"].sum(axis=1).max())
            tests = (
                np.ascontiguousarray(archive[name][:, :longest]) for name in ("command", "travel", "counted")
            )
            return cls(*tests, archive["bounds"], float(archive["step_s"]))

    @property
    def weights(self) -> np.ndarray:
        """What each squared error counts, each test the same in all: they sum to one, shape [T, N]."""
        return self.counted / (self.counted.sum(axis=1, keepdims=True) * len(self.counted))

    def error(self, position: np.ndarray, weights: np.ndarray) -> float:
        """Return J at a position in the unit cube, over logarithms."""
        lower, upper = self.bounds
        gain, omega, damping = lower * (upper / lower) ** position
        continuous = [gain], [1 / omega**2, 2 * damping / omega, 1.0, 0.0]
        numerator, denominator, _ = cont2discrete(continuous, self.step_s, method="zoh")
        residuals = lfilter(numerator[0], denominator, self.command, axis=1) - self.travel
        return float(np.sqrt(np.vdot(weights, residuals * residuals)))


# For matrices of four rows and for 16 016 samples waiting for a second thread costs far more than it saves.
single_threaded = threadpool_limits.wrap(limits=1)


@single_threaded
def evaluate(tests: Lifting, positions: np.ndarray) -> list[float]:
    """Return J at each position."""
    weights = tests.weights
    return [tests.error(position, weights) for position in positions]


@single_threaded
def search(tests: Lifting, seed: int, whales: int, iterations: int) -> float:
    """Search the unit cube with as many evaluations as whales times iterations; return the best J."""
    from mealpy import FloatVar
    from mealpy.swarm_based.WOA import OriginalWOA

    weights = tests.weights
    problem = {
        "obj_func": lambda position: tests.error(position, weights),
        "bounds": FloatVar(lb=(0.0,) * 3, ub=(1.0,) * 3),
        "minmax": "min",
        "log_to": None,
    }
    # The first swarm is evaluated before the first of its epochs.
    best = OriginalWOA(epoch=iterations - 1, pop_size=whales).solve(problem, mode="single", seed=seed)
    return float(best.target.fitness)
