"""Machines that stand out: each compared with the fleet without it, at a controlled false discovery rate."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtri, stdtr, stdtrit

from hitchid._support.short_repr import short_repr
from hitchid._support.values import Value
from hitchid.errors import InputError
from hitchid.fleet.arguments import checked_estimates
from hitchid.fleet.multiple_testing import adjusted_p_values
from hitchid.fleet.random_effects import fit_random_effects

FEWEST = 10  # machines with a parameter; of fewer the p-values are not uniform (simulated)
FOLDS = 200  # fits of a parameter; in a larger fleet machines are left out in groups; chosen
POWER = 0.9  # probability at which a deviation counts as detectable; chosen


@short_repr
@dataclass(frozen=True, eq=False)
class Outliers(Value):
    """Comparison of each machine with the others, all of shape [N, P]; NaN where nothing is compared.

    Attributes:
        deviation: estimate minus mean of the other machines, in the parameter's unit.
        error: standard error of the deviation, without the spread between machines.
        t: deviation over its predictive standard deviation, which includes the spread between machines.
        freedom: degrees of freedom of t.
        p_value: two-sided, uniform for a machine that is like the others.
        q_value: smallest false discovery rate at which the machine is named.
        named: whether the machine stands out in this parameter.
        lower: end of the interval of the deviation, of those named.
        upper: other end; the false coverage rate of these intervals is the false discovery rate.
        detectable: deviation that would be named with a probability of 90 % if it were the only one.
    """

    deviation: Float[np.ndarray, "n p"]
    error: Float[np.ndarray, "n p"]
    t: Float[np.ndarray, "n p"]
    freedom: Float[np.ndarray, "n p"]
    p_value: Float[np.ndarray, "n p"]
    q_value: Float[np.ndarray, "n p"]
    named: Bool[np.ndarray, "n p"]
    lower: Float[np.ndarray, "n p"]
    upper: Float[np.ndarray, "n p"]
    detectable: Float[np.ndarray, "n p"]

    @property
    def ranking(self) -> tuple[tuple[int, int], ...]:
        """Machine and parameter of each discovery, smallest p-value first."""
        cells = np.argwhere(self.named)
        order = np.argsort(self.p_value[self.named], kind="stable")
        return tuple((int(machine), int(parameter)) for machine, parameter in cells[order])


def find_outliers(
    estimates: Float[np.ndarray, "n p"],
    covariances: Float[np.ndarray, "n p p"],
    *,
    false_discovery_rate: float = 0.1,
) -> Outliers:
    """Return which machines stand out in which parameter.

    With mean μ, its variance v and variance between machines τ² of the fleet without machine i:
    t = (y − μ)/√(s² + τ² + v), Student's t with 2 (s² + τ²)²/Var(τ²) degrees of freedom.

    Args:
        estimates: y of each machine, shape [N, P], NaN where missing; such as the logarithm of a gain and a
            dead zone.
        covariances: of the errors, shape [N, P, P]; s² is their diagonal.
        false_discovery_rate: expected share of sound ones among the named pairs of machine and parameter.

    Raises:
        InputError: estimates that cannot be used, or a rate that is not between 0 and 1.

    Source: Benjamini & Hochberg 1995; Benjamini & Yekutieli 2005, False discovery rate-adjusted multiple
        confidence intervals; Satterthwaite 1946.
    """
    if not 0 < false_discovery_rate < 1:
        raise InputError(f"false_discovery_rate: got {false_discovery_rate}, expected between 0 and 1")
    values, errors = checked_estimates(estimates, covariances)
    deviation, error, predictive, freedom = _comparisons(values, np.diagonal(errors, axis1=1, axis2=2))
    t = deviation / predictive
    p_value = 2 * stdtr(freedom, -np.abs(t))
    q_value = adjusted_p_values(p_value)
    named = q_value <= false_discovery_rate
    tests = max(1, int(np.sum(~np.isnan(p_value))))
    half_width = -ndtri(false_discovery_rate * max(1, int(named.sum())) / tests / 2) * error
    half_width[~named] = np.nan
    threshold = -stdtrit(freedom, false_discovery_rate / tests / 2)
    return Outliers(
        deviation,
        error,
        t,
        freedom,
        p_value,
        q_value,
        named,
        deviation - half_width,
        deviation + half_width,
        threshold * predictive + ndtri(POWER) * error,
    )


def _comparisons(values: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Return the columns of `_compare` for all parameters, NaN where nothing is compared, shape [4, N, P]."""
    comparisons = np.full((4, *values.shape), np.nan)
    for parameter in range(values.shape[1]):
        present = ~np.isnan(values[:, parameter])
        if present.sum() >= FEWEST:
            comparisons[:, present, parameter] = _compare(
                values[present, parameter], variances[present, parameter]
            )
    return comparisons


def _compare(values: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return deviation, its error, predictive standard deviation and degrees of freedom of each machine."""
    machines = np.arange(len(values))
    fold = machines % min(FOLDS, len(values))
    fit = fit_random_effects(values, variances, np.ones((len(values), 1)), fold != np.unique(fold)[:, None])
    mean, mean_variance = fit.coefficients[fold, 0], fit.covariance[fold, 0, 0]
    total = variances + fit.between[fold]
    return (
        values - mean,
        np.sqrt(variances + mean_variance),
        np.sqrt(total + mean_variance),
        2 * total**2 / fit.between_variance[fold],
    )
