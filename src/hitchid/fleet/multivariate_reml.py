"""Restricted maximum likelihood of mean and covariance of several parameters over machines."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from hitchid.fleet.robustness import constants_of, weights

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


class Population(NamedTuple):
    """Mean μ, shape [P], covariance between machines Σ, shape [P, P], weight of each machine, shape [N]."""

    mean: Float[np.ndarray, " p"]
    between: Float[np.ndarray, "p p"]
    weights: Float[np.ndarray, " n"]


def estimates_of(
    values: Float[np.ndarray, "n p"], covariances: Float[np.ndarray, "n p p"], *, robust: bool
) -> Estimates:
    """Return estimates that are NaN where missing without gaps; not `robust`: every machine counts fully."""
    present = ~np.isnan(values)
    pairs = present[:, :, None] & present[:, None, :]
    constants = [constants_of(int(number), robust=robust) for number in present.sum(axis=1)]
    return Estimates(
        np.where(present, values, 0.0),
        np.where(pairs, covariances, np.eye(values.shape[1])),
        pairs.astype(float),
        np.array([each.clip for each in constants]),
        np.array([each.consistency for each in constants]),
    )


def precisions(estimates: Estimates, between: Float[np.ndarray, "*n p p"]) -> Float[np.ndarray, "n p p"]:
    """Return (S + Σ)⁻¹ of each machine, zero for missing parameters; Σ of all or of each."""
    return np.linalg.inv(estimates.errors + estimates.pairs * between) * estimates.pairs


def fit_population(estimates: Estimates, deviations: Float[np.ndarray, " p"]) -> Population:
    """Return mean and covariance between machines: Σ = L Lᵀ for fixed weights and the weights, in turn.

    Args:
        estimates: of parameters that are scaled to a variance of about one.
        deviations: standard deviations between machines at the start, above zero, shape [P].
    """
    size = len(deviations)
    elements = np.diag(deviations)[np.tril_indices(size)]
    on_diagonal = np.equal(*np.tril_indices(size))
    weight = _weights(estimates, _lower(elements, size), np.ones(len(estimates.values)))
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
    between = _without_zeros(_lower(elements, size))
    return Population(_mean(estimates, precisions(estimates, between), weight), between, weight)


def _lower(elements: np.ndarray, size: int) -> np.ndarray:
    """Return the triangular matrix L of its elements."""
    lower = np.zeros((size, size))
    lower[np.tril_indices(size)] = elements
    return lower


def _without_zeros(lower: np.ndarray) -> np.ndarray:
    """Return Σ = L Lᵀ with variances that are zeros of the search set to zero."""
    between = lower @ lower.T
    without = np.diagonal(between) <= 4 * NO_SPREAD**2
    between[without] = 0.0
    between[:, without] = 0.0
    return between


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
