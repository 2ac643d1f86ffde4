"""Standard error of the dead zone, which is identified before the parameters, and its degrees of freedom."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from hitchid.estimation import Objective

CONFIDENCE = 0.95  # level of every interval


class DeadZoneError(NamedTuple):
    """Standard error of the dead zone.

    Attributes:
        standard_error: in the command's unit; 0 for a dead zone that was given.
        tests: number of ramps or tests it was identified from.
    """

    standard_error: float = 0.0
    tests: int = 0

    def shifted_by_one_sigma(self, objective: Objective) -> Objective:
        """Return the objective with the dead zone one standard error larger."""
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
        degrees: degrees of freedom of each, broadcastable to that shape.
    """
    denominator = np.sum(variances**2 / degrees, axis=0)
    degrees = np.sum(variances, axis=0) ** 2 / np.maximum(denominator, np.finfo(float).tiny)
    return np.asarray(np.maximum(degrees, 1.0))


def t_quantile(degrees: float) -> float:
    """Return the two-sided 95 % quantile of Student's t."""
    return float(stdtrit(degrees, 0.5 + CONFIDENCE / 2))
