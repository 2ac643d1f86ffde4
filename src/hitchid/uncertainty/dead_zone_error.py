"""The error of a dead zone that was found beforehand, and what it does to what is found behind it."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from hitchid.estimation import Objective

CONFIDENCE = 0.95


class DeadZoneError(NamedTuple):
    """How well the dead zone is known that parameters were found behind.

    Attributes:
        standard_error: standard error, in the command's unit; 0 where it is given.
        tests: ramps or tests it was found from.
    """

    standard_error: float = 0.0
    tests: int = 0

    def shifted_by_one_sigma(self, objective: Objective) -> Objective:
        """Return the misfit with the dead zone one standard error farther."""
        return objective.with_data(
            objective.batch.with_dead_zones(objective.batch.dead_zone + self.standard_error)
        )

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the standard error."""
        return max(self.tests - 1, 1)


NO_ERROR = DeadZoneError()


def welch_satterthwaite(variances: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return the degrees of freedom of sums of variances, (Σ v)²/Σ v²/ν (Welch 1947, Biometrika 34, 28).

    Args:
        variances: shape [V, ...].
        degrees: of each, of a shape that goes with it.
    """
    denominator = np.sum(variances**2 / degrees, axis=0)
    degrees = np.sum(variances, axis=0) ** 2 / np.maximum(denominator, np.finfo(float).tiny)
    return np.asarray(np.maximum(degrees, 1.0))


def t_quantile(degrees: float) -> float:
    """Return how many standard errors lie on either side of 95 % of Student's t."""
    return float(stdtrit(degrees, 0.5 + CONFIDENCE / 2))
