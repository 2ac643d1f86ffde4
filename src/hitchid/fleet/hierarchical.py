"""Hierarchical model of a fleet: mean and spread over machines, and the value of each machine."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri, stdtrit

from hitchid._support.short_repr import short_repr
from hitchid._support.values import Value
from hitchid.errors import InputError
from hitchid.fleet.arguments import checked_estimates
from hitchid.fleet.multivariate_reml import Estimates, Population, estimates_of, fit_population, precisions
from hitchid.fleet.random_effects import fit_random_effects
from hitchid.fleet.robustness import constants_of
from hitchid.fleet.spread_interval import spread_interval

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


def fit_hierarchy(
    estimates: Float[np.ndarray, "n p"], covariances: Float[np.ndarray, "n p p"], *, robust: bool = True
) -> Hierarchy:
    """Return mean, spread and the values of the machines by restricted maximum likelihood.

    y = μ + b + e with b ~ N(0, Σ), e ~ N(0, S), V = S + Σ: μ and Σ minimise
    Σᵢ [log|V| + w/κ (y − μ)ᵀV⁻¹(y − μ)] + log|Σᵢ V⁻¹|, with w = min(1, c²/d²), d² = (y − μ)ᵀV⁻¹(y − μ).
    The value of a machine is μ + (Σ/w) (S + Σ/w)⁻¹ (y − μ): one that stands out is hardly moved.

    Args:
        estimates: y of each machine, shape [N, P], NaN where missing.
        covariances: S of the errors, shape [N, P, P].
        robust: False for plain restricted maximum likelihood, w = κ = 1.

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
    marginals = [_marginal(values[:, each], errors[:, each, each], robust) for each in range(len(counts))]
    centre, scale, deviations, spreads = (np.array(column) for column in zip(*marginals, strict=True))
    squared_scale = np.outer(scale, scale)
    scaled = estimates_of((values - centre) / scale, errors / squared_scale, robust=robust)
    fit = fit_population(scaled, deviations)
    population = Population(centre + scale * fit.mean, squared_scale * fit.between, fit.weights)
    mean_factor = constants_of(len(counts), robust=robust).mean_factor
    return _hierarchy(estimates_of(values, errors, robust=robust), population, counts, spreads, mean_factor)


def _marginal(
    values: np.ndarray, variances: np.ndarray, robust: bool
) -> tuple[float, float, float, tuple[float, float]]:
    """Return mean, scale, scaled deviation between machines and its interval of one parameter on its own."""
    present = ~np.isnan(values)
    values, variances = values[present], variances[present]
    everything = np.ones((1, values.size), bool)
    fit = fit_random_effects(values, variances, everything.T * 1.0, everything, robust=robust)
    between = float(fit.between[0])
    scale = float(np.sqrt(between + np.median(variances)))
    interval = spread_interval(values, variances, robust=robust)
    return float(fit.coefficients[0, 0]), scale, max(START, np.sqrt(between) / scale), interval


def _hierarchy(
    estimates: Estimates,
    population: Population,
    counts: np.ndarray,
    spreads: np.ndarray,
    mean_factor: float,
) -> Hierarchy:
    mean = population.mean
    mean_covariance = mean_factor * np.linalg.inv(precisions(estimates, population.between).sum(axis=0))
    values, deviations = _machine_values(estimates, population, mean_covariance)
    mean_deviations = np.sqrt(np.diagonal(mean_covariance))
    return Hierarchy(
        mean,
        mean_covariance,
        _interval(mean, stdtrit(counts - 1, (1 + LEVEL) / 2) * mean_deviations),
        population.between,
        spreads,
        values,
        deviations,
        _interval(values, ndtri((1 + LEVEL) / 2) * deviations),
        population.weights,
    )


def _interval(middle: np.ndarray, half_width: np.ndarray) -> np.ndarray:
    return np.stack([middle - half_width, middle + half_width], axis=-1)


def _machine_values(
    estimates: Estimates, population: Population, mean_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the best prediction of μ + b of each machine and its standard deviation, shape [N, P] each."""
    own = population.between / population.weights[:, None, None]
    shrinkage = own @ precisions(estimates, own)
    remaining = np.eye(len(population.mean)) - shrinkage
    covariance = remaining @ own + remaining @ mean_covariance @ remaining.swapaxes(1, 2)
    residuals = estimates.values - population.mean
    values = population.mean + np.einsum("npq,nq->np", shrinkage, residuals)
    return values, np.sqrt(np.maximum(0.0, np.diagonal(covariance, axis1=1, axis2=2)))
