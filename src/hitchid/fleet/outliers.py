"""Machines that stand out: each compared with the fleet without it, at a controlled false discovery rate."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import fdtrc, ndtri, stdtr, stdtrit

from hitchid._support.records import Value, short_repr
from hitchid.errors import InputError
from hitchid.fleet.random_effects import (
    adjusted_p_values,
    checked_estimates,
    fit_random_effects,
    normal_constants,
)

# Cohorts: do machines of other types, oils or ages have other parameters?

LEVEL = 0.95  # of the intervals
FEWEST_IN_COHORT = 3  # machines of a category that is compared; chosen
FEWEST_LEFT = 3  # machines more than coefficients, from which there is a test; chosen

Column = Sequence[str | float | None] | np.ndarray  # texts or numbers


@short_repr
@dataclass(frozen=True)
class CohortEffect:
    """Comparison of one parameter over one column of the metadata.

    Attributes:
        column: its name.
        parameter: index of the parameter.
        labels: categories, sorted; empty for a column of numbers.
        machines: number of machines that are compared.
        values: mean of each category, in the parameter's unit, or the slope alone, per unit of the column.
        intervals: 95 % interval of each value.
        p_value: of equal means, or of no slope.
        q_value: smallest false discovery rate at which it is a discovery, over columns and parameters.
    """

    column: str
    parameter: int
    labels: tuple[str, ...]
    machines: int
    values: tuple[float, ...]
    intervals: tuple[tuple[float, float], ...]
    p_value: float
    q_value: float = np.nan


def compare_cohorts(
    estimates: Float[np.ndarray, "n p"],
    covariances: Float[np.ndarray, "n p p"],
    columns: Mapping[str, Column],
) -> tuple[CohortEffect, ...]:
    """Return the effect of each column on each parameter.

    y = X β + b + e, b ~ N(0, τ²), e ~ N(0, s²): X indicates the categories of a column of texts, or contains
    one and the numbers. With C β = 0 for equal means or no slope and β ~ N(·, φ Cov):
    (C β)ᵀ(C φ Cov Cᵀ)⁻¹(C β)/q is F(q, ν), φ = max(1, Σ min(z², c²)/κ/(n − k)).

    Args:
        estimates: of each machine, shape [N, P], NaN where missing.
        covariances: of the errors, shape [N, P, P].
        columns: name to a text or a number for each machine; None, an empty text or NaN where unknown. A
            category of fewer than three machines is left out.

    Raises:
        InputError: estimates that cannot be used, or a column of another length.

    Source: Knapp & Hartung 2003, Improved tests for a random effects meta-regression with a single covariate;
        Benjamini & Hochberg 1995.
    """
    values, errors = checked_estimates(estimates, covariances)
    for name, column in columns.items():
        if len(column) != len(values):
            raise InputError(f"columns: '{name}': got {len(column)} values, expected {len(values)}")
    effects = [
        effect
        for name, column in columns.items()
        for effect in _effects(name, column, values, np.diagonal(errors, axis1=1, axis2=2))
    ]
    q_values = adjusted_p_values(np.array([effect.p_value for effect in effects]))
    return tuple(replace(effect, q_value=float(q)) for effect, q in zip(effects, q_values, strict=True))


def _effects(name: str, column: Column, values: np.ndarray, variances: np.ndarray) -> Iterator[CohortEffect]:
    numeric = not any(isinstance(cell, str) for cell in column)
    for parameter in range(values.shape[1]):
        compared = ~np.isnan(values[:, parameter])
        # Parameters lack different machines, so that each has categories and a design of its own.
        labels, design, compared = _slope(column, compared) if numeric else _categories(column, compared)
        machines = int(compared.sum())
        coefficients = design.shape[1]
        if coefficients < 2 or machines < coefficients + FEWEST_LEFT or np.linalg.matrix_rank(design) < 2:
            continue  # no effect, or one without a test
        own = values[compared, parameter], variances[compared, parameter]
        beta, covariance, freedom = _regression(*own, design)
        tested = np.eye(coefficients)[1:] - (0 if numeric else np.eye(coefficients)[0])
        difference = tested @ beta
        squares = difference @ np.linalg.solve(tested @ covariance @ tested.T, difference)
        p_value = float(fdtrc(len(tested), freedom, squares / len(tested)))
        half_width = stdtrit(freedom, (1 + LEVEL) / 2) * np.sqrt(np.diagonal(covariance))
        shown = slice(1, None) if numeric else slice(None)
        ends = zip((beta - half_width)[shown], (beta + half_width)[shown], strict=True)
        intervals = tuple((float(lower), float(upper)) for lower, upper in ends)
        yield CohortEffect(name, parameter, labels, machines, tuple(beta[shown].tolist()), intervals, p_value)


def _slope(column: Column, compared: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return no labels, the columns one and number about its mean, and which machines are compared."""
    numbers = np.array([np.nan if cell is None else cell for cell in column], float)
    compared = compared & np.isfinite(numbers)
    # About its mean, so that slope and mean do not depend on each other.
    centred = numbers[compared] - (numbers[compared].mean() if compared.any() else 0.0)
    return (), np.stack([np.ones_like(centred), centred], axis=1), compared


def _categories(column: Column, compared: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Return the categories, their indicators, and which machines are compared."""
    texts = np.array([cell if isinstance(cell, str) else "" for cell in column])
    names, counts = np.unique(texts[compared & (texts != "")], return_counts=True)
    labels = tuple(names[counts >= FEWEST_IN_COHORT].tolist())
    compared = compared & np.isin(texts, labels)
    return labels, (texts[compared, None] == np.array(labels, texts.dtype)).astype(float), compared


def _regression(
    values: np.ndarray, variances: np.ndarray, design: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return coefficients, their covariance and its degrees of freedom."""
    fit = fit_random_effects(values, variances, design, np.ones((1, len(values)), bool))
    constants = normal_constants()
    beta = fit.coefficients[0]
    # Knapp & Hartung: what scatters more than τ² and the errors explain widens the intervals, never less.
    squared = (values - design @ beta) ** 2 / (variances + fit.between[0])
    left = len(values) - len(beta)
    scatter = np.minimum(squared, constants.clip).sum() / constants.consistency / left
    return beta, max(1.0, float(scatter)) * fit.covariance[0], constants.efficiency * left


# Trends: parameters of machines that were identified several times, and of the fleet.

FEWEST_SLOPES = 3  # machines with a slope, from which the fleet has one; chosen
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
        return tuple((int(self.machines[rows[cell]]), int(parameters[cell])) for cell in order)


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

    def total(terms: np.ndarray) -> np.ndarray:
        return np.bincount(row, terms, machines)

    with np.errstate(invalid="ignore", divide="ignore"):
        weight = total(precision)
        centred = times - (total(precision * times) / weight)[row]
        spread = total(precision * centred**2)
        # Rounding may leave a single time some distance from its own mean, and with it a slope.
        spread[total(np.ones_like(values)) < 2] = 0.0
        slopes = np.where(spread > 0, total(precision * centred * values) / spread, np.nan)
        residuals = values - (total(precision * values) / weight)[row] - slopes[row] * centred
        leverage = precision * (1 / weight[row] + centred**2 / spread[row])
    # A point that its line goes through, as each of two, says nothing of the scatter.
    free = (leverage < 1 - TOLERANCE) & ~np.isnan(residuals)
    freedom = float(np.sum(1 - leverage[free]))
    # One factor for all machines: few results of each say little of its own scatter.
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
    if slopes.size < FEWEST_SLOPES:
        return np.nan, np.nan, np.nan
    everything = np.ones((1, slopes.size), bool)
    fit = fit_random_effects(slopes, errors**2, everything.T * 1.0, everything)
    mean, error = float(fit.coefficients[0, 0]), float(np.sqrt(fit.covariance[0, 0, 0]))
    half_width = float(stdtrit(slopes.size - 1, (1 + LEVEL) / 2)) * error
    return mean, mean - half_width, mean + half_width


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
    variances = np.diagonal(errors, axis1=1, axis2=2)
    comparisons = np.full((4, *values.shape), np.nan)
    for parameter in range(values.shape[1]):
        present = ~np.isnan(values[:, parameter])
        if present.sum() >= FEWEST:
            own = values[present, parameter], variances[present, parameter]
            comparisons[:, present, parameter] = _beside_the_others(*own)
    deviation, error, predictive, freedom = comparisons
    t = deviation / predictive
    p_value = 2 * stdtr(freedom, -np.abs(t))
    q_value = adjusted_p_values(p_value)
    named = q_value <= false_discovery_rate
    # The wider the fewer are named: these are the largest of many deviations, which were selected.
    tests = max(1, int(np.sum(~np.isnan(p_value))))
    half_width = -ndtri(false_discovery_rate * max(1, int(named.sum())) / tests / 2) * error
    half_width[~named] = np.nan
    # As if it were the only one named: the first of m tests has to pass q/m.
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


def _beside_the_others(values: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return deviation, its error, predictive standard deviation and degrees of freedom of each machine."""
    # A machine must not be in the mean that it is compared with: it would hide itself.
    fold = np.arange(len(values)) % min(FOLDS, len(values))
    fit = fit_random_effects(values, variances, np.ones((len(values), 1)), fold != np.unique(fold)[:, None])
    mean, mean_variance = fit.coefficients[fold, 0], fit.covariance[fold, 0, 0]
    total = variances + fit.between[fold]
    return (
        values - mean,
        np.sqrt(variances + mean_variance),
        np.sqrt(total + mean_variance),
        2 * total**2 / fit.between_variance[fold],
    )
