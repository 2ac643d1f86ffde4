"""Bands around a channel's predictions, calibrated on tests that were held out in turn."""

import jax.numpy as jnp
import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.identification.phase1 import Phase1
from hitchid.model import Channel
from hitchid.model.possible import possible, spread
from hitchid.structures import Batch
from hitchid.uncertainty.bands import LEVELS, Alternative, Bands, calibrated, free_run_scores, sensor_noise

FEWEST_TESTS = 3
FARTHEST = 0.25
KEPT = 0.99


def calibrate(channel: Channel, phase1: Phase1, everything: Batch, validation: Batch) -> Bands | None:
    """Find bands around the predictions of a channel.

    Each test is predicted in free run by what it has not taught: parameters without it, to first order, and
    the one network that has not seen it. Looking ahead is judged on the tests that stopped the training.

    Args:
        channel: compensators and all.
        phase1: its benchmark, and how far other tests would move it.
        everything: all identification tests.
        validation: those that stopped the training.

    Returns:
        The bands; None where there are fewer than three tests.
    """
    tests = everything.command.shape[0]
    if tests < FEWEST_TESTS:
        return None
    counted = np.asarray(everything.counted)
    alternatives = _alternatives(channel, phase1)
    _, apart = spread(channel, alternatives, everything)
    sizes = np.mean(apart[:, counted] ** 2, axis=1)
    order = np.argsort(sizes)[::-1]
    enough = 1 + int(np.searchsorted(np.cumsum(sizes[order]), KEPT * sizes.sum()))
    kept = np.sort(order[:enough])
    spreads = np.sqrt(np.sum(apart[kept] ** 2, axis=0))
    errors = np.asarray(everything.displacement) - _held_out(channel, phase1, everything)
    missed = [row[counts] for row, counts in zip(errors, counted, strict=True)]
    apart_by = [row[counts] for row, counts in zip(spreads, counted, strict=True)]
    noise = sensor_noise(missed)
    horizons, ahead = _ahead(channel, validation)
    return Bands(
        alternatives=tuple(alternatives[number] for number in kept),
        noise=noise,
        levels=LEVELS,
        free_run=tuple(
            calibrated(free_run_scores(missed, apart_by, noise, level), level) for level in LEVELS
        ),
        horizons=horizons,
        ahead=ahead,
        tests=(tests, validation.command.shape[0]),
    )


def _alternatives(channel: Channel, phase1: Phase1) -> list[Alternative]:
    """Return what might as well be true: a standard error along each principal axis, each network alone.

    No axis goes farther than a quarter of the room between bounds, or beyond these.
    """
    moved, position = phase1.moved, phase1.fit.position
    sizes, axes = np.linalg.eigh(moved.covariance)
    alternatives = []
    for size, axis in zip(np.sqrt(np.maximum(sizes, 0.0)), axes.T, strict=True):
        step = size * axis
        step *= min(1.0, FARTHEST / max(float(np.abs(step).max()), FARTHEST))
        inside = position + step if np.all(np.abs(position + step - 0.5) <= 0.5) else position - step
        alternatives.append(Alternative(_row(channel, phase1, np.clip(inside, 0.0, 1.0))))
    if channel.speed_compensator is not None:
        members = channel.speed_compensator.networks.head.weight.shape[0]
        here = tuple(map(float, channel.benchmark.row))
        alternatives += [
            Alternative(here, member, 1 / np.sqrt(max(members - 1, 1))) for member in range(members)
        ]
    return alternatives


def _row(channel: Channel, phase1: Phase1, position: np.ndarray) -> tuple[float, ...]:
    """Return the numbers of the benchmark at a position, its gain levelled as the channel's was."""
    misfit = phase1.fit.misfit
    row = np.array(misfit.form.benchmark(jnp.asarray(misfit.values(position)), misfit.scales).row)
    row[0] *= float(channel.benchmark.values[0]) / phase1.fit.values[0]
    return tuple(map(float, row))


def _held_out(channel: Channel, phase1: Phase1, batch: Batch) -> np.ndarray:
    """Return each test's free run by what it has not taught, shape [T, N]."""
    tests = batch.command.shape[0]
    moved, position = phase1.moved.by_test, phase1.fit.position
    members = 1 if channel.speed_compensator is None else len(channel.speed_compensator.networks.head.weight)
    rows = []
    for test in range(tests):
        without = np.clip(position - moved[test], 0.0, 1.0) if len(moved) == tests else position
        alone = Alternative(_row(channel, phase1, without), test % members)
        rows.append(np.asarray(possible(channel, alone).simulate(batch.take([test])))[0])
    return np.stack(rows)


def _ahead(channel: Channel, batch: Batch) -> tuple[tuple[int, ...], tuple[tuple[float, ...], ...]]:
    """Return horizons, and for each of them the half width at each level."""
    counted, measured = np.asarray(batch.counted), np.asarray(batch.displacement)
    horizons = tuple(h for h in HORIZONS if h < counted.sum(axis=1).min())
    predicted = np.asarray(channel.predict(batch, horizons))
    told = [counted & (np.arange(counted.shape[1]) >= h) for h in horizons]
    missed = [
        [np.abs(y - p)[here] for y, p, here in zip(measured, rows, now, strict=True)]
        for rows, now in zip(predicted, told, strict=True)
    ]
    return horizons, tuple(tuple(calibrated(rows, level) for level in LEVELS) for rows in missed)
