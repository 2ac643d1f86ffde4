"""Cross-fitting: the benchmark fitted to the tests of all folds but one, for each fold in turn."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hitchid.baselines.registry import delayed
from hitchid.errors import FitError
from hitchid.estimation import refine_subset
from hitchid.identification.phase1 import Phase1, with_calibrated_gain
from hitchid.model import Channel
from hitchid.structures import Batch
from hitchid.uncertainty.conformal import CALIBRATED_HORIZONS, FURTHER_HORIZONS, HeldOutErrors

FOLDS = 4  # every fourth test is held out together; chosen
STEPS = 10  # least-squares positions of a refit, which starts at the optimum over all tests; chosen


def folds_of(tests: int) -> list[Bool[np.ndarray, " t"]]:
    """Return which tests each fold holds out: every fourth; with fewer tests each is a fold."""
    fold = np.arange(tests) % min(FOLDS, tests)
    return [fold == number for number in np.unique(fold)]


class HeldOut(NamedTuple):
    """A mask of tests, and the channel that was fitted to the others."""

    tests: Bool[np.ndarray, " t"]
    channel: Channel


def cross_fitted(channel: Channel, phase1: Phase1) -> tuple[HeldOut, ...]:
    """Return for each fold of tests the channel with the benchmark refitted without it, uncompensated.

    A fold without which the refit fails keeps the parameters of all tests. A gain calibration stays.
    """
    uncompensated = replace(channel, compensator=None, speed_compensator=None)
    folds = folds_of(phase1.fit.objective.batch.command.shape[0])
    return tuple(
        HeldOut(tests, with_position(uncompensated, phase1, _refitted(phase1, tests))) for tests in folds
    )


def held_out_free_runs(held_out: Sequence[HeldOut], batch: Batch) -> np.ndarray:
    """Return each test's free run by the channel fitted without it, shape [T, N]."""
    runs = np.empty(batch.displacement.shape)
    for tests, channel in held_out:
        runs[tests] = of_tests(channel.simulate(batch.take(filled(held_out, tests))), tests)
    return runs


def filled(held_out: Sequence[HeldOut], tests: np.ndarray) -> list[int]:
    """Return the tests of a fold, repeated to the size of the largest, so that all share a program."""
    return np.resize(np.flatnonzero(tests), max(int(fold.sum()) for fold, _ in held_out)).tolist()


def of_tests(rows: object, tests: np.ndarray) -> np.ndarray:
    """Return rows of shape [..., T', N] without the repeated tests."""
    return np.asarray(rows)[..., : int(tests.sum()), :]


def with_position(channel: Channel, phase1: Phase1, position: np.ndarray) -> Channel:
    """Return a channel with the benchmark at another position; a calibration of its gain stays."""
    objective = phase1.fit.objective
    benchmark = objective.spec.physical_model(jnp.asarray(objective.values(position)), objective.scales)
    if objective.spec.structure.gain:
        benchmark = benchmark.with_gain(float(channel.benchmark.gain) / phase1.fit.gain)
    return replace(channel, benchmark=benchmark)


def _refitted(phase1: Phase1, held_out: Bool[np.ndarray, " t"]) -> Float[np.ndarray, " d"]:
    objective, position = phase1.fit.objective, phase1.fit.position
    free = np.flatnonzero(phase1.influence.free).tolist()
    if not free or held_out.all():
        return position
    training, refitted = objective.over(~held_out), position.copy()
    try:
        refitted[free] = refine_subset(training, free, [position], STEPS).position
    except FitError:
        return position
    return with_calibrated_gain(training, refitted)


# Errors of predictions of each test by the channel that was fitted without it.

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
    """Return for each horizon shorter than all tests the errors of predictions of the tests."""
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
