"""Interval of the standard deviation of one parameter between machines."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar
from scipy.special import chdtri

from hitchid.fleet.robustness import NormalConstants, constants_of, weights

LEVEL = 0.95  # of the interval
ITERATIONS, TOLERANCE = 100, 1e-9  # of the mean; relative to the smallest standard deviation; chosen
LARGEST = 1e6  # upper end of the search, in sums of squares of the values; chosen


def spread_interval(
    values: Float[np.ndarray, " n"], variances: Float[np.ndarray, " n"], *, robust: bool = True
) -> tuple[float, float]:
    """Return the 95 % interval of τ, in the parameter's unit.

    Its ends are where Q(τ²) = Σ min(z², c²)/κ, z² = (y − μ)²/(s² + τ²), is a quantile of its distribution:
    ε Q ~ χ² with ε (n − 1) degrees of freedom, ε the efficiency of the robust variance.

    Args:
        values: y, estimates of one parameter, shape [N].
        variances: s², squared standard errors, shape [N].
        robust: False for κ = ε = 1 without a limit c.

    Source: Viechtbauer 2007, Confidence intervals for the amount of heterogeneity in meta-analysis.
    """
    constants = constants_of(1, robust=robust)
    freedom = constants.efficiency * (values.size - 1)
    largest = LARGEST * float(np.sum((values - np.median(values)) ** 2) + np.max(variances))

    def end(tail: float) -> float:
        quantile = float(chdtri(freedom, tail))

        def excess(between: float) -> float:
            return constants.efficiency * _clipped_squares(values, variances + between, constants) - quantile

        if excess(0.0) <= 0:
            return 0.0
        return float(np.sqrt(_root(excess, largest)))

    return end((1 - LEVEL) / 2), end((1 + LEVEL) / 2)


def _root(function: Callable[[float], float], largest: float) -> float:
    found = root_scalar(function, bracket=(0.0, largest), method="brentq", rtol=TOLERANCE)
    return found.root


def _clipped_squares(values: np.ndarray, total: np.ndarray, constants: NormalConstants) -> float:
    """Return Q for known variances; the robust mean is iterated from the median."""
    mean = float(np.median(values))
    for _ in range(ITERATIONS):
        precision = weights((values - mean) ** 2 / total, constants.clip) / total
        updated = float(precision @ values / precision.sum())
        change, mean = abs(updated - mean), updated
        if change <= TOLERANCE * np.sqrt(float(total.min())):
            break
    return float(np.minimum(constants.clip, (values - mean) ** 2 / total).sum() / constants.consistency)
