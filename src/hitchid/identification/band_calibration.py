"""Prediction bands of a channel, calibrated by cross-conformal prediction on tests held out in turn."""

import jax.numpy as jnp
import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.identification.phase1 import Phase1
from hitchid.model import Channel
from hitchid.model.bands import Bands, EnsembleMember
from hitchid.model.ensemble import ensemble_deviations, perturbed_channel
from hitchid.structures import Batch
from hitchid.uncertainty.conformal import (
    LEVELS,
    conformal_quantile,
    nonconformity_scores,
    sensor_noise,
)

FEWEST_TESTS = 3  # chosen: fewer held-out errors give no usable quantile
MAX_STEP = 0.25  # largest deviation of an ensemble member, share of the range between bounds; chosen
VARIANCE_SHARE = 0.99  # share of the ensemble's variance that the selected members explain; chosen


def calibrate_bands(channel: Channel, phase1: Phase1, all_tests: Batch, validation: Batch) -> Bands | None:
    """Return the prediction bands of a channel.

    Each test is predicted in free run by a model that was fitted without it: parameters to first order, and
    the one network that was not trained on it. Horizons are evaluated on the validation tests.

    Args:
        channel: benchmark and compensators.
        phase1: its benchmark, and the influence of each test on it.
        all_tests: all identification tests.
        validation: tests that stopped the training.

    Returns:
        The bands; None where there are fewer than three tests.
    """
    tests = all_tests.command.shape[0]
    if tests < FEWEST_TESTS:
        return None
    loss_mask = np.asarray(all_tests.loss_mask)
    ensemble = _ensemble(channel, phase1)
    _, deviations = ensemble_deviations(channel, ensemble, all_tests)
    mean_squares = np.mean(deviations[:, loss_mask] ** 2, axis=1)
    # A member whose free run diverges gives no width to a band.
    mean_squares = np.where(np.isfinite(mean_squares), mean_squares, 0.0)
    order = np.argsort(mean_squares)[::-1]
    n_selected = 1 + int(np.searchsorted(np.cumsum(mean_squares[order]), VARIANCE_SHARE * mean_squares.sum()))
    selected = np.sort(order[:n_selected])
    spreads = np.sqrt(np.sum(deviations[selected] ** 2, axis=0))
    errors = np.asarray(all_tests.displacement) - _held_out(channel, phase1, all_tests)
    residuals = [row[mask] for row, mask in zip(errors, loss_mask, strict=True)]
    spread_by_test = [row[mask] for row, mask in zip(spreads, loss_mask, strict=True)]
    noise = sensor_noise(residuals)
    horizons, half_widths = _horizon_half_widths(channel, validation)
    return Bands(
        ensemble=tuple(ensemble[number] for number in selected),
        noise=noise,
        levels=LEVELS,
        free_run=tuple(
            conformal_quantile(nonconformity_scores(residuals, spread_by_test, noise, level), level)
            for level in LEVELS
        ),
        horizons=horizons,
        half_widths=half_widths,
        tests=(tests, validation.command.shape[0]),
    )


def _ensemble(channel: Channel, phase1: Phase1) -> list[EnsembleMember]:
    """Return the ensemble: one standard error along each principal axis, and each single network.

    A member deviates by at most a quarter of the range between bounds and lies within the bounds.
    """
    influence, position = phase1.influence, phase1.fit.position
    sizes, axes = np.linalg.eigh(influence.covariance)
    ensemble = []
    for size, axis in zip(np.sqrt(np.maximum(sizes, 0.0)), axes.T, strict=True):
        step = size * axis
        step *= min(1.0, MAX_STEP / max(float(np.abs(step).max()), MAX_STEP))
        shifted = position + step if np.all(np.abs(position + step - 0.5) <= 0.5) else position - step
        ensemble.append(EnsembleMember(_parameter_vector(channel, phase1, np.clip(shifted, 0.0, 1.0))))
    if channel.speed_compensator is not None:
        members = channel.speed_compensator.members
        parameter_vector = tuple(map(float, channel.benchmark.parameter_vector))
        ensemble += [
            EnsembleMember(parameter_vector, member, 1 / np.sqrt(max(members - 1, 1)))
            for member in range(members)
        ]
    return ensemble


def _parameter_vector(channel: Channel, phase1: Phase1, position: np.ndarray) -> tuple[float, ...]:
    """Return the benchmark's parameter vector at a position, with the gain calibration of the channel."""
    objective = phase1.fit.objective
    vector = np.array(
        objective.spec.physical_model(
            jnp.asarray(objective.values(position)), objective.scales
        ).parameter_vector
    )
    if objective.spec.structure.gain:
        vector[objective.spec.structure.gain_index] *= float(channel.benchmark.gain) / phase1.fit.gain
    return tuple(map(float, vector))


def _held_out(channel: Channel, phase1: Phase1, batch: Batch) -> np.ndarray:
    """Return each test's free run by the model fitted without it, shape [T, N]."""
    tests = batch.command.shape[0]
    influence_by_test, position = phase1.influence.by_test, phase1.fit.position
    members = 1 if channel.speed_compensator is None else channel.speed_compensator.members
    rows = []
    for test in range(tests):
        position_without_test = (
            np.clip(position - influence_by_test[test], 0.0, 1.0)
            if len(influence_by_test) == tests
            else position
        )
        ensemble_member = EnsembleMember(
            _parameter_vector(channel, phase1, position_without_test), test % members
        )
        rows.append(np.asarray(perturbed_channel(channel, ensemble_member).simulate(batch.take([test])))[0])
    return np.stack(rows)


def _horizon_half_widths(
    channel: Channel, batch: Batch
) -> tuple[tuple[int, ...], tuple[tuple[float, ...], ...]]:
    """Return the horizons, and the half width of each horizon at each level."""
    loss_mask, measured = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    horizons = tuple(horizon for horizon in HORIZONS if horizon < loss_mask.sum(axis=1).min())
    predicted = np.asarray(channel.predict(batch, horizons))
    predictable = [loss_mask & (np.arange(loss_mask.shape[1]) >= horizon) for horizon in horizons]
    absolute_errors = [
        [np.abs(y - p)[mask] for y, p, mask in zip(measured, rows, masks, strict=True)]
        for rows, masks in zip(predicted, predictable, strict=True)
    ]
    return horizons, tuple(
        tuple(conformal_quantile(rows, level) for level in LEVELS) for rows in absolute_errors
    )
