"""Errors of predictions of each test by the channel that was fitted without it."""

from collections.abc import Iterable, Sequence

import numpy as np

from hitchid.baselines.persistence import delayed
from hitchid.identification.cross_fitting import HeldOut, filled, of_tests
from hitchid.structures import Batch
from hitchid.uncertainty.prediction_spread import CALIBRATED_HORIZONS, FURTHER_HORIZONS, HeldOutErrors

FURTHEST_S = 1.0  # furthest prediction that is judged; chosen: the one shown beside a running machine
# Samples of all tests from which predictions start, which bounds the time; chosen: neighbours are alike, and
# their scatter is that between tests.
MAX_ORIGINS = 4_000
ROUNDING = 1e-9  # of a number of samples in a time


def within_a_second(horizons: Iterable[int], step_s: float) -> tuple[int, ...]:
    """Return the horizons, in samples, that are no further than `FURTHEST_S`."""
    return tuple(horizon for horizon in horizons if horizon * step_s <= FURTHEST_S * (1 + ROUNDING))


def calibrated_horizons(step_s: float) -> tuple[int, ...]:
    """Return the horizons at which predictions are judged, samples: up to 100, or up to a second."""
    return (*CALIBRATED_HORIZONS, *within_a_second(FURTHER_HORIZONS, step_s))


def held_out_errors(
    held_out: Sequence[HeldOut], batch: Batch, horizons: Iterable[int]
) -> dict[int, HeldOutErrors]:
    """Return for each horizon shorter than all tests the errors of predictions of the tests.

    Args:
        held_out: channels fitted without each fold; every test is held out once.
        batch: all tests.
        horizons: in samples, ascending.
    """
    loss_mask, measured = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    shortest = loss_mask.sum(axis=1).min()
    horizons = tuple(horizon for horizon in horizons if horizon < shortest)
    if not horizons:
        return {}
    predicted = np.empty((len(horizons), *measured.shape))
    every = max(1, int(loss_mask.sum()) // MAX_ORIGINS)
    for tests, channel in held_out:
        rows = channel.predict(batch.take(filled(held_out, tests)), horizons, every)
        predicted[:, tests] = of_tests(rows, tests)
    errors, samples = {}, np.arange(loss_mask.shape[1])
    for horizon, rows in zip(horizons, predicted, strict=True):
        mask = loss_mask & (samples >= horizon) & ((samples - horizon) % every == 0)
        movement = rows - delayed(measured, horizon)
        errors[horizon] = HeldOutErrors(rows_of_tests(measured - rows, mask), rows_of_tests(movement, mask))
    return errors


def rows_of_tests(values: np.ndarray, mask: np.ndarray) -> list[np.ndarray]:
    """Return the values of each test that count, arrays of shape [N_i]."""
    return [row[row_mask] for row, row_mask in zip(values, mask, strict=True)]
