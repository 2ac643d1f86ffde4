"""Trends: parameters of machines that were identified several times, and of the fleet."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import stdtr, stdtrit

from hitchid._support.short_repr import short_repr
from hitchid._support.values import Value
from hitchid.errors import InputError
from hitchid.fleet.arguments import checked_estimates
from hitchid.fleet.multiple_testing import adjusted_p_values
from hitchid.fleet.random_effects import fit_random_effects
from hitchid.fleet.robustness import normal_constants

LEVEL = 0.95  # of the intervals
FEWEST = 3  # machines with a slope, from which the fleet has one; chosen
ITERATIONS, TOLERANCE = 100, 1e-9  # of the scatter; relative; chosen
KNOWN_ERRORS = 1e9  # degrees of freedom where no scatter about lines can be seen: a normal distribution


@short_repr
@dataclass(frozen=True, eq=False)
class FleetTrends(Value):
    """Slopes over time, in the parameter's unit per unit of time; NaN where a machine has no two times.

    Attributes:
        machines: that were identified, sorted, shape [N].
        slopes: of each machine and parameter, shape [N, P].
        errors: standard errors, shape [N, P].
        lower: lower end of the 95 % interval, shape [N, P].
        upper: upper end, shape [N, P].
        p_values: of no slope, two-sided, shape [N, P].
        q_values: smallest false discovery rate at which the machine is named, shape [N, P].
        fleet_slopes: mean slope over machines, shape [P]; NaN with fewer than three machines.
        fleet_intervals: 95 % intervals, shape [P, 2].
        scatter: factor on the standard errors of the estimates, from the scatter about the lines, shape [P].
    """

    machines: Int[np.ndarray, " n"]
    slopes: Float[np.ndarray, "n p"]
    errors: Float[np.ndarray, "n p"]
    lower: Float[np.ndarray, "n p"]
    upper: Float[np.ndarray, "n p"]
    p_values: Float[np.ndarray, "n p"]
    q_values: Float[np.ndarray, "n p"]
    fleet_slopes: Float[np.ndarray, " p"]
    fleet_intervals: Float[np.ndarray, "p 2"]
    scatter: Float[np.ndarray, " p"]

    @property
    def ranking(self) -> tuple[tuple[int, int], ...]:
        """Machine and parameter of each slope, smallest p-value first."""
        rows, parameters = np.nonzero(~np.isnan(self.p_values))
        order = np.argsort(self.p_values[rows, parameters], kind="stable")
        return tuple((int(self.machines[rows[each]]), int(parameters[each])) for each in order)


def fit_trends(
    machines: Int[np.ndarray, " m"],
    times: Float[np.ndarray, " m"],
    estimates: Float[np.ndarray, "m p"],
    covariances: Float[np.ndarray, "m p p"],
) -> FleetTrends:
    """Return the slope of each parameter of each machine, and that of the fleet.

    y(t) = a + β t + e, e ~ N(0, φ s²), least squares weighted by 1/s² for each machine; φ ≥ 1, common to all,
    from their scatter about the lines. The fleet's slope is the mean of a random-effects model of the slopes.

    Args:
        machines: machine of each identification, shape [M].
        times: of each identification, in any unit, such as h of operation, shape [M].
        estimates: shape [M, P], NaN where missing.
        covariances: of the errors, shape [M, P, P].

    Raises:
        InputError: arrays that do not agree or cannot be used.

    Source: weighted linear regression; DerSimonian & Laird 1986 for the fleet.
    """
    values, errors = checked_estimates(estimates, covariances)
    numbers, hours = np.asarray(machines), np.asarray(times, float)
    if numbers.shape != (len(values),) or hours.shape != numbers.shape or not np.isfinite(hours).all():
        raise InputError(
            f"machines, times: got shapes {numbers.shape} and {hours.shape}, expected ({len(values)},) "
            "and finite times"
        )
    names, row = np.unique(numbers, return_inverse=True)
    variances = np.diagonal(errors, axis1=1, axis2=2)
    lines = [_lines(row, len(names), hours, values[:, p], variances[:, p]) for p in range(values.shape[1])]
    slopes, slope_errors, freedom, scatter = (np.array(part) for part in zip(*lines, strict=True))
    fleet = np.array([_fleet_slope(*line) for line in zip(slopes, slope_errors, strict=True)])
    half_width = (stdtrit(freedom, (1 + LEVEL) / 2)[:, None] * slope_errors).T
    slopes, slope_errors = slopes.T, slope_errors.T
    p_values = 2 * stdtr(freedom, -np.abs(slopes / slope_errors))
    return FleetTrends(
        names,
        slopes,
        slope_errors,
        slopes - half_width,
        slopes + half_width,
        p_values,
        adjusted_p_values(p_values),
        fleet[:, 0],
        fleet[:, 1:],
        scatter,
    )


def _lines(
    row: np.ndarray, machines: int, times: np.ndarray, values: np.ndarray, variances: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Return slopes and their errors, degrees of freedom and factor on the errors, of one parameter."""
    present = ~np.isnan(values)
    row, times, values = row[present], times[present], values[present]
    precision = 1 / variances[present]

    def total(each: np.ndarray) -> np.ndarray:
        return np.bincount(row, each, machines)

    with np.errstate(invalid="ignore", divide="ignore"):
        weight = total(precision)
        centred = times - (total(precision * times) / weight)[row]
        spread = total(precision * centred**2)
        spread[total(np.ones_like(values)) < 2] = 0.0
        slopes = np.where(spread > 0, total(precision * centred * values) / spread, np.nan)
        residuals = values - (total(precision * values) / weight)[row] - slopes[row] * centred
        leverage = precision * (1 / weight[row] + centred**2 / spread[row])
    free = (leverage < 1 - TOLERANCE) & ~np.isnan(residuals)
    freedom = float(np.sum(1 - leverage[free]))
    factor = _scatter((residuals**2 * precision)[free] / (1 - leverage[free]))
    with np.errstate(divide="ignore"):
        slope_errors = np.where(spread > 0, np.sqrt(factor / spread), np.nan)
    freedom = normal_constants().efficiency * freedom if freedom else KNOWN_ERRORS
    return slopes, slope_errors, freedom, float(np.sqrt(factor))


def _scatter(squares: np.ndarray) -> float:
    """Return φ ≥ 1 with mean min(z²/φ, c²) = κ; 1 without any squares."""
    constants, factor = normal_constants(), 1.0
    for _ in range(ITERATIONS if squares.size else 0):
        ratio = float(np.minimum(squares / factor, constants.clip).mean()) / constants.consistency
        updated = max(1.0, factor * ratio)
        change, factor = abs(updated - factor), updated
        if change <= TOLERANCE * factor:
            break
    return factor


def _fleet_slope(slopes: np.ndarray, errors: np.ndarray) -> tuple[float, float, float]:
    """Return mean slope over machines and the ends of its interval."""
    slopes, errors = slopes[~np.isnan(slopes)], errors[~np.isnan(slopes)]
    if slopes.size < FEWEST:
        return np.nan, np.nan, np.nan
    everything = np.ones((1, slopes.size), bool)
    fit = fit_random_effects(slopes, errors**2, everything.T * 1.0, everything)
    mean, error = float(fit.coefficients[0, 0]), float(np.sqrt(fit.covariance[0, 0, 0]))
    half_width = float(stdtrit(slopes.size - 1, (1 + LEVEL) / 2)) * error
    return mean, mean - half_width, mean + half_width
