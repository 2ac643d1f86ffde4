"""Distribution of parameters over the machines of a fleet: mean, spread, and where another machine lies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.special import ndtri, stdtrit

from hitchid._support.records import Value, short_repr
from hitchid.errors import InputError
from hitchid.fleet.parameters import FleetParameter
from hitchid.fleet.random_effects import (
    checked_estimates,
    constants_of,
    fit_random_effects,
    spread_interval,
    weights,
)

# Restricted maximum likelihood of mean and covariance of several parameters over machines.

REWEIGHTINGS, TOLERANCE = 100, 1e-5  # of the machines; largest change of a weight; chosen
GRADIENT = 1e-7  # of the criterion per machine, at which a search stops; chosen
NO_SPREAD = 1e-4  # scaled standard deviation between machines that is a zero of the search; chosen


class Estimates(NamedTuple):
    """Estimates of N machines; a missing parameter has the error one and no share in any sum.

    Attributes:
        values: y, zero where missing, shape [N, P].
        errors: S, covariance of the errors, shape [N, P, P].
        pairs: one where both parameters are present, shape [N, P, P].
        clip: squared distance from which a machine loses weight, shape [N].
        consistency: κ of each machine, shape [N].
    """

    values: Float[np.ndarray, "n p"]
    errors: Float[np.ndarray, "n p p"]
    pairs: Float[np.ndarray, "n p p"]
    clip: Float[np.ndarray, " n"]
    consistency: Float[np.ndarray, " n"]


def estimates_of(values: Float[np.ndarray, "n p"], covariances: Float[np.ndarray, "n p p"]) -> Estimates:
    """Return estimates that are NaN where missing without gaps."""
    present = ~np.isnan(values)
    pairs = present[:, :, None] & present[:, None, :]
    # A machine that lacks a parameter is nearer to the mean: its distance has fewer degrees of freedom.
    constants = [constants_of(int(number)) for number in present.sum(axis=1)]
    return Estimates(
        np.where(present, values, 0.0),
        np.where(pairs, covariances, np.eye(values.shape[1])),
        pairs.astype(float),
        np.array([own.clip for own in constants]),
        np.array([own.consistency for own in constants]),
    )


def precisions(estimates: Estimates, between: Float[np.ndarray, "*n p p"]) -> Float[np.ndarray, "n p p"]:
    """Return (S + Σ)⁻¹ of each machine, zero for missing parameters; Σ of all or of each."""
    return np.linalg.inv(estimates.errors + estimates.pairs * between) * estimates.pairs


def _fit(estimates: Estimates, deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return μ [P], Σ [P, P] and the weights [N]: Σ = L Lᵀ for fixed weights and the weights, in turn.

    The parameters are scaled to a variance of about one; the search starts at deviations above zero.
    """
    size = len(deviations)
    # A triangle L keeps Σ = L Lᵀ a covariance wherever the search goes.
    elements = np.diag(deviations)[np.tril_indices(size)]
    on_diagonal = np.equal(*np.tril_indices(size))
    weight = _weights(estimates, _lower(elements, size), np.ones(len(estimates.values)))
    # The gradient is that of fixed weights, which follow after each search.
    for _ in range(REWEIGHTINGS):
        # A standard deviation of exactly zero has no gradient: the search could not leave it.
        elements = np.where(on_diagonal & (np.abs(elements) < NO_SPREAD), NO_SPREAD, elements)
        elements = minimize(
            _criterion,
            elements,
            args=(estimates, weight),
            jac=True,
            method="L-BFGS-B",
            options={"ftol": 0.0, "gtol": GRADIENT},
        ).x
        updated = _weights(estimates, _lower(elements, size), weight)
        change, weight = np.max(np.abs(updated - weight)), updated
        if change <= TOLERANCE:
            break
    lower = _lower(elements, size)
    between = lower @ lower.T
    # What the lift from zero leaves would be shown as a spread that nobody has seen.
    is_zero = np.diagonal(between) <= 4 * NO_SPREAD**2
    between[is_zero] = 0.0
    between[:, is_zero] = 0.0
    return _mean(estimates, precisions(estimates, between), weight), between, weight


def _lower(elements: np.ndarray, size: int) -> np.ndarray:
    """Return the triangular matrix L of its elements."""
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = elements
    return lower


def _mean(estimates: Estimates, precision: np.ndarray, weight: np.ndarray) -> np.ndarray:
    weighted = (weight / estimates.consistency)[:, None, None] * precision
    return np.linalg.solve(weighted.sum(axis=0), np.einsum("npq,nq->p", weighted, estimates.values))


def _scores(estimates: Estimates, precision: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return V⁻¹(y − μ), shape [N, P], and d², shape [N]."""
    residuals = estimates.values - _mean(estimates, precision, weight)
    scores = np.einsum("npq,nq->np", precision, residuals)
    return scores, np.sum(residuals * scores, axis=1)


def _weights(estimates: Estimates, lower: np.ndarray, weight: np.ndarray) -> np.ndarray:
    squared = _scores(estimates, precisions(estimates, lower @ lower.T), weight)[1]
    return weights(squared, estimates.clip)


def _criterion(elements: np.ndarray, estimates: Estimates, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """Return half the restricted deviance per machine for fixed weights, and its gradient by L."""
    machines, size = estimates.values.shape
    lower = _lower(elements, size)
    between = lower @ lower.T
    precision = precisions(estimates, between)
    scores, squared = _scores(estimates, precision, weight)
    information = precision.sum(axis=0)
    relative = weight / estimates.consistency
    determinants = np.linalg.slogdet(estimates.errors + estimates.pairs * between)[1]
    deviance = determinants.sum() + relative @ squared + np.linalg.slogdet(information)[1]
    by_mean = np.einsum("npq,qr,nrs->ps", precision, np.linalg.inv(information), precision)
    slope = information - (relative[:, None] * scores).T @ scores - by_mean
    return float(deviance) / 2 / machines, (slope @ lower)[np.tril_indices(size)] / machines


# Hierarchical model of a fleet: mean and spread over machines, and the value of each machine.

LEVEL = 0.95  # of the intervals
FEWEST = 3  # machines with a parameter; of fewer, mean and spread have no interval
START = 0.3  # smallest standard deviation between machines at the start, scaled parameter; chosen


@short_repr
@dataclass(frozen=True, eq=False)
class Hierarchy(Value):
    """Distribution of P parameters over machines, in the parameters' units.

    Attributes:
        mean: μ, shape [P].
        mean_covariance: of μ, shape [P, P].
        mean_interval: 95 % interval of μ, shape [P, 2].
        between: Σ, covariance between machines, shape [P, P]; zero on the diagonal where no spread is seen.
        spread_interval: 95 % interval of the standard deviation between machines, shape [P, 2].
        values: μ + b of each machine given all estimates, shape [N, P]; μ of a machine without estimates.
        value_deviations: their standard deviations, shape [N, P].
        value_intervals: their 95 % intervals, shape [N, P, 2].
        weights: of each machine, one of a machine like the others, shape [N].
    """

    mean: Float[np.ndarray, " p"]
    mean_covariance: Float[np.ndarray, "p p"]
    mean_interval: Float[np.ndarray, "p 2"]
    between: Float[np.ndarray, "p p"]
    spread_interval: Float[np.ndarray, "p 2"]
    values: Float[np.ndarray, "n p"]
    value_deviations: Float[np.ndarray, "n p"]
    value_intervals: Float[np.ndarray, "n p 2"]
    weights: Float[np.ndarray, " n"]

    @property
    def spread(self) -> Float[np.ndarray, " p"]:
        """Standard deviation between machines, in the parameters' units."""
        return np.sqrt(np.diagonal(self.between))


def fit_hierarchy(estimates: Float[np.ndarray, "n p"], covariances: Float[np.ndarray, "n p p"]) -> Hierarchy:
    """Return mean, spread and the values of the machines by restricted maximum likelihood.

    y = μ + b + e with b ~ N(0, Σ), e ~ N(0, S), V = S + Σ: μ and Σ minimise
    Σᵢ [log|V| + w/κ (y − μ)ᵀV⁻¹(y − μ)] + log|Σᵢ V⁻¹|, with w = min(1, c²/d²), d² = (y − μ)ᵀV⁻¹(y − μ).
    The value of a machine is μ + (Σ/w) (S + Σ/w)⁻¹ (y − μ): one that stands out is hardly moved.

    Args:
        estimates: y of each machine, shape [N, P], NaN where missing.
        covariances: S of the errors, shape [N, P, P].

    Raises:
        InputError: estimates that cannot be used, or a parameter with fewer than three machines.

    Source: DerSimonian & Laird 1986; Jackson, Riley & White 2011, Multivariate meta-analysis; McLachlan &
        Krishnan 2008 (weights of a scale mixture); Viechtbauer 2007 (interval of the spread).
    """
    values, errors = checked_estimates(estimates, covariances)
    counts = np.sum(~np.isnan(values), axis=0)
    if np.any(counts < FEWEST):
        parameter = int(np.argmin(counts))
        raise InputError(
            f"estimates: parameter {parameter}: got {counts[parameter]} machines, expected at least {FEWEST}"
        )
    # The search's limits are of parameters with a variance of about one, whatever their units.
    marginals = [_marginal(values[:, p], errors[:, p, p]) for p in range(len(counts))]
    centre, scale, deviations, spreads = (np.array(column) for column in zip(*marginals, strict=True))
    squared_scale = np.outer(scale, scale)
    scaled = estimates_of((values - centre) / scale, errors / squared_scale)
    scaled_mean, scaled_between, weight = _fit(scaled, deviations)
    mean, between = centre + scale * scaled_mean, squared_scale * scaled_between
    estimated, mean_factor = estimates_of(values, errors), constants_of(len(counts)).mean_factor
    mean_covariance = mean_factor * np.linalg.inv(precisions(estimated, between).sum(axis=0))
    # A machine that stands out has a wide Σ of its own, so that its values are hardly moved to the mean.
    own = between / weight[:, None, None]
    shrinkage = own @ precisions(estimated, own)
    remaining = np.eye(len(mean)) - shrinkage
    covariance = remaining @ own + remaining @ mean_covariance @ remaining.swapaxes(1, 2)
    machine_values = mean + np.einsum("npq,nq->np", shrinkage, estimated.values - mean)
    # Rounding may leave a variance of zero, of a machine without spread, below it.
    value_deviations = np.sqrt(np.maximum(0.0, np.diagonal(covariance, axis1=1, axis2=2)))
    mean_deviations = np.sqrt(np.diagonal(mean_covariance))
    return Hierarchy(
        mean,
        mean_covariance,
        _interval(mean, stdtrit(counts - 1, (1 + LEVEL) / 2) * mean_deviations),
        between,
        spreads,
        machine_values,
        value_deviations,
        _interval(machine_values, ndtri((1 + LEVEL) / 2) * value_deviations),
        weight,
    )


def _marginal(values: np.ndarray, variances: np.ndarray) -> tuple[float, float, float, tuple[float, float]]:
    """Return mean, scale, scaled deviation between machines and its interval of one parameter on its own."""
    present = ~np.isnan(values)
    values, variances = values[present], variances[present]
    everything = np.ones((1, values.size), bool)
    fit = fit_random_effects(values, variances, everything.T * 1.0, everything)
    between = float(fit.between[0])
    scale = float(np.sqrt(between + np.median(variances)))
    interval = spread_interval(values, variances)
    return float(fit.coefficients[0, 0]), scale, max(START, np.sqrt(between) / scale), interval


def _interval(middle: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    return np.stack([middle - half_width, middle + half_width], axis=-1)


class Population(NamedTuple):
    """Distribution of one parameter over machines, of its estimates; NaN with fewer than three machines.

    Attributes:
        machines: number of machines with the parameter.
        mean: over machines.
        mean_interval: 95 % interval of the mean.
        spread: standard deviation between machines.
        spread_interval: 95 % interval of the spread.
        prediction_interval: contains the parameter of another machine with a probability of 95 %.
    """

    machines: int
    mean: float = np.nan
    mean_interval: tuple[float, float] = (np.nan, np.nan)
    spread: float = np.nan
    spread_interval: tuple[float, float] = (np.nan, np.nan)
    prediction_interval: tuple[float, float] = (np.nan, np.nan)


def hierarchies_of(
    parameters: Sequence[FleetParameter], estimates: np.ndarray, covariances: np.ndarray
) -> dict[str, tuple[tuple[int, ...], Hierarchy]]:
    """Return direction to the parameters that at least three machines have, and their model."""
    enough = np.sum(~np.isnan(estimates), axis=0) >= FEWEST
    hierarchies = {}
    for direction in dict.fromkeys(parameter.direction for parameter in parameters):
        columns = [
            index
            for index, parameter in enumerate(parameters)
            if parameter.direction == direction and enough[index]
        ]
        if columns:
            fit = fit_hierarchy(*selected(estimates, covariances, np.array(columns)))
            hierarchies[direction] = (tuple(columns), fit)
    return hierarchies


def populations_of(
    estimates: np.ndarray, hierarchies: Mapping[str, tuple[tuple[int, ...], Hierarchy]]
) -> tuple[Population, ...]:
    """Return the distribution of each parameter.

    A further machine lies within μ ± t √(τ² + Var μ), with n − 1 degrees of freedom.

    Source: Partlett & Riley 2017, Random effects meta-analysis: coverage performance of 95 % confidence and
        prediction intervals.
    """
    counts = np.sum(~np.isnan(estimates), axis=0)
    populations = [Population(int(count)) for count in counts]
    for columns, fit in hierarchies.values():
        for row, column in enumerate(columns):
            mean, variance = float(fit.mean[row]), float(fit.mean_covariance[row, row])
            deviation = float(np.sqrt(fit.between[row, row] + variance))
            half_width = float(stdtrit(counts[column] - 1, (1 + LEVEL) / 2)) * deviation
            populations[column] = Population(
                int(counts[column]),
                mean,
                tuple(fit.mean_interval[row].tolist()),
                float(fit.spread[row]),
                tuple(fit.spread_interval[row].tolist()),
                (mean - half_width, mean + half_width),
            )
    return tuple(populations)


def selected(
    estimates: np.ndarray, covariances: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates and covariances of some of the parameters."""
    return estimates[:, columns], covariances[:, columns[:, None], columns]
