"""Drift of a machine: how gain and dead zone have changed between its identification and new logs.

In free run over the new tests, θ = (Δ ln gain, Δ dead zone) is fitted to the errors e by Gauss–Newton steps

    θ ← θ + (JᵀJ + P)⁻¹ (Jᵀe − P θ),   J = ∂ŷ/∂θ,   P = s² diag(1/σ²),

where the weak prior σ keeps a parameter at zero that the commands do not determine. Tests are independent,
the samples of one are not: the covariance is H⁻¹ Σ gₜ gₜᵀ H⁻¹ T/(T − 2), H = JᵀJ + P, gₜ = Jₜᵀeₜ.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import f as f_distribution

from hitchid._support.precision import double_precision
from hitchid.adaptation.parameters import changed_benchmark
from hitchid.data.record import Record
from hitchid.fleet.row import DirectionRow, DriftRow
from hitchid.model import Channel
from hitchid.structures import Batch

Errors = Callable[[np.ndarray], np.ndarray]
"""θ to the errors of all tests, shape [2] to [T, N]."""
STEPS = 6  # Gauss-Newton steps; changes of 50 % converge to 1e-6 in five
PRIOR_GAIN, PRIOR_DEAD_ZONE = 0.5, 0.3  # σ of ln gain, and of the dead zone as share of the largest command
DIFFERENCE = 1e-3  # of ln gain, and of the dead zone as share of the largest command: derivatives to 1e-6
PARAMETERS = 2
MIN_TESTS = 4  # clusters from which a covariance of two parameters and Hotelling's test exist, T ≥ 2 p


class Change(NamedTuple):
    """Fitted θ with the covariance of its error, shape [2] and [2, 2]."""

    theta: np.ndarray
    covariance: np.ndarray


def drift_of(channel: Channel, records: Sequence[Record], identified: DirectionRow) -> DriftRow:
    """Return the change of one direction between its identification and new tests.

    Args:
        channel: the model.
        records: new tests of the direction.
        identified: the figures of the identification, with their errors.
    """
    batch = channel.batch(records)
    mask = np.asarray(batch.loss_mask & batch.valid)
    errors = (np.asarray(batch.displacement) - np.asarray(channel.simulate(batch)))[mask]
    unchanged = DriftRow(
        None,
        None,
        None,
        None,
        None,
        rmse=float(np.sqrt(np.mean(errors**2))),
        reference_rmse=identified.held_out_rmse or identified.rmse,
        tests=len(records),
    )
    if len(records) < MIN_TESTS:
        return unchanged
    change = fit_change(channel, records)
    covariance = change.covariance + _identification_covariance(identified)
    deviations = np.sqrt(np.diag(covariance))
    return replace(
        unchanged,
        gain_change=float(np.expm1(change.theta[0])),
        gain_change_error=float(np.exp(change.theta[0]) * deviations[0]),
        dead_zone_change=float(change.theta[1]),
        dead_zone_change_error=float(deviations[1]),
        p_value=None if identified.gain_error is None else _p_value(change.theta, covariance, len(records)),
    )


@double_precision
def fit_change(channel: Channel, records: Sequence[Record]) -> Change:
    """Fit the change of ln gain and dead zone to the free runs over at least three tests."""
    batch = channel.batch(records)
    mask = np.asarray(batch.loss_mask & batch.valid)
    largest = float(np.max(np.abs(np.where(mask, np.asarray(batch.raw_command), 0.0))))
    scale = np.array([1.0, largest])

    def errors_at(theta: np.ndarray) -> np.ndarray:
        simulated = np.asarray(_changed(channel, theta).simulate(_with_dead_zone(batch, theta[1])))
        return np.where(mask, np.asarray(batch.displacement) - simulated, 0.0)

    prior = 1 / (np.array([PRIOR_GAIN, PRIOR_DEAD_ZONE]) * scale) ** 2
    theta = np.zeros(PARAMETERS)
    for _ in range(STEPS):
        theta = theta + _step(errors_at, theta, prior, scale)[0]
    _, normal, scores = _step(errors_at, theta, prior, scale)
    inverse, tests = np.linalg.inv(normal), len(records)
    return Change(theta, tests / (tests - PARAMETERS) * inverse @ scores.T @ scores @ inverse)


def _step(
    errors_at: Errors, theta: np.ndarray, prior: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a Gauss-Newton step [2], JᵀJ + P [2, 2], and the score of each test [T, 2]."""
    errors = errors_at(theta)
    slopes = np.stack([_slope(errors_at, theta, step) for step in np.diag(DIFFERENCE * scale)])
    weight = np.diag(prior * np.sum(errors**2) / max(np.count_nonzero(errors), 1))
    normal = np.einsum("ptn,qtn->pq", slopes, slopes) + weight
    scores = np.einsum("ptn,tn->tp", slopes, errors)
    return np.linalg.solve(normal, scores.sum(axis=0) - weight @ theta), normal, scores


def _slope(errors_at: Errors, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return ∂ŷ/∂θ along one parameter, by a central difference of the errors, shape [T, N]."""
    return (errors_at(theta - step) - errors_at(theta + step)) / (2 * np.max(step))


def _changed(channel: Channel, theta: np.ndarray) -> Channel:
    changes = jnp.array([theta[0], theta[1], 0.0])
    return replace(channel, benchmark=changed_benchmark(channel.benchmark, changes))


def _with_dead_zone(batch: Batch, change: float) -> Batch:
    return batch.with_dead_zones(batch.dead_zone + change)


def _identification_covariance(identified: DirectionRow) -> np.ndarray:
    """Return the covariance of the errors of ln gain and dead zone as identified, shape [2, 2]."""
    errors = np.array([identified.gain_error or 0.0, identified.dead_zone_error])
    return np.outer(errors, errors) * np.array([[1.0, identified.correlation], [identified.correlation, 1.0]])


def _p_value(theta: np.ndarray, covariance: np.ndarray, tests: int) -> float:
    """Return the p-value of Hotelling's T² with tests − 1 degrees of freedom."""
    below = tests - PARAMETERS
    statistic = float(theta @ np.linalg.pinv(covariance) @ theta)
    return float(f_distribution.sf(statistic * below / (PARAMETERS * (tests - 1)), PARAMETERS, below))
