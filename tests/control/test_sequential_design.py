"""Sequential design: what tests say of a plant that is known, and tests that help it."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid._support.precision import double_precision
from hitchid.control.sequential_design import (
    CANDIDATES,
    PRIOR,
    Duties,
    best_test,
    draw_tests,
    free_run_slopes,
    information,
    learn,
    lowest_level,
    staircase,
    within,
)
from hitchid.structures import Batch

STEP_S, ZONE, GAIN, LAG_S, NOISE = 0.02, 0.3, 50.0, 0.1, 0.05  # s, A, mm/(s·A), s, mm
TRAVEL, HIGHEST = 250.0, 0.9  # mm, A


@double_precision
def measured(count, seed):
    """Return tests of an integrator with a lag behind a dead zone, with noise of the sensor."""
    rng = np.random.default_rng(seed)
    commands = np.stack([staircase(0.25, HIGHEST, 8.0, STEP_S, rng)[0] for _ in range(count)])
    effective = np.maximum(commands - ZONE, 0.0)
    speed, keep = np.zeros(count), np.exp(-STEP_S / LAG_S)
    travel = np.zeros_like(commands)
    for sample in range(1, commands.shape[1]):
        # The exact response of the lag to a held command, and its integral.
        target = GAIN * effective[:, sample - 1]
        travel[:, sample] = travel[:, sample - 1] + target * STEP_S + (speed - target) * LAG_S * (1 - keep)
        speed = target + (speed - target) * keep
    shape = commands.shape
    return Batch(
        command=jnp.asarray(effective),
        raw_command=jnp.asarray(commands),
        dead_zone=jnp.full(count, ZONE),
        displacement=jnp.asarray(travel + NOISE * rng.standard_normal(shape)),
        valid=jnp.ones(shape, bool),
        loss_mask=jnp.ones(shape, bool),
        initial=jnp.zeros(count),
        covariates=jnp.zeros((count, 0)),
        step_s=STEP_S,
        sign=1,
    )


@pytest.fixture(scope="module")
def known():
    """Return what two tests say."""
    return learn(measured(2, 0))


def duties_of(known):
    return Duties(known, 0.0, TRAVEL, HIGHEST, 8.0)


def test_fit_reaches_the_noise_of_the_sensor(known):
    assert known.rmse == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_no_test_leaves_more_open(known, seed):
    duties = duties_of(known)
    commands, _ = draw_tests(known, 4, 4.0, HIGHEST, seed)
    _, slopes = free_run_slopes(known, commands, 0.0)
    before = duties.variance(known.precision)
    # Up to rounding of the solution, whose matrix has a condition of 1e9.
    after = [duties.variance(known.precision + information(known, rows)) for rows in slopes]
    assert max(after) <= before * (1 + 1e-6)


def test_a_fit_goes_on_from_the_last_one(known):
    later = learn(measured(4, 0), last=known)
    afresh = learn(measured(4, 0))
    assert later.rmse <= 1.01 * afresh.rmse


def test_nothing_is_known_before_the_first_test_but_the_prior(known):
    before = duties_of(known).variance(np.eye(len(known.position)) / PRIOR**2)
    assert before > 100 * duties_of(known).variance(known.precision)


def test_slopes_are_the_derivatives_of_the_free_run(known):
    commands, _ = draw_tests(known, 3, 4.0, HIGHEST, 5)
    travel, slopes = free_run_slopes(known, commands, 0.0)
    direction = np.ones(len(known.position)) / len(known.position)
    step = 1e-6
    moved = replace(known, position=known.position + step * direction)
    difference = (free_run_slopes(moved, commands, 0.0)[0] - travel) / step
    scale = np.abs(slopes @ direction).max()
    # A forward difference is wrong by its step times the curvature, and by rounding over the step.
    assert np.abs(difference - slopes @ direction).max() < 1e-3 * scale


def test_chosen_test_beats_the_middle_of_the_candidates(known):
    duties, options = duties_of(known), {"start": 0.0, "available": TRAVEL, "highest": HIGHEST}
    chosen = best_test(known, duties, **options, longest_s=8.0, overhead_s=1.0, seed=3)
    commands, _ = draw_tests(known, CANDIDATES, 8.0, HIGHEST, 3)
    travel, slopes = free_run_slopes(known, commands, 0.0)
    after = [
        duties.variance(known.precision + information(known, jacobian[: within(row, TRAVEL)]))
        for row, jacobian in zip(travel, slopes, strict=True)
    ]
    assert chosen.variance <= np.median(after)
    assert chosen.variance < duties.variance(known.precision)


def test_chosen_test_stays_within_travel_and_command(known):
    chosen = best_test(
        known,
        duties_of(known),
        start=0.0,
        available=100.0,
        highest=0.7,
        longest_s=8.0,
        overhead_s=1.0,
        seed=1,
    )
    assert chosen.commands.max() <= 0.7
    assert chosen.commands.min() >= 0.0
    assert chosen.travel <= 100.0


def test_no_test_fits_where_there_is_no_way(known):
    options = {"start": 0.0, "available": 0.0, "highest": HIGHEST, "longest_s": 8.0, "overhead_s": 1.0}
    # Not even for the shortest test: the piston moves within its first second.
    moving = [best_test(known, duties_of(known), **options, seed=seed) for seed in range(3)]
    assert all(choice is None or choice.travel <= 1e-9 for choice in moving)


def test_levels_come_once_each_from_below_the_dead_zone_to_the_highest():
    rows = [staircase(lowest_level(0.4), 1.0, 10.0, 0.01, np.random.default_rng(n))[0] for n in range(20)]
    levels = np.unique(np.concatenate(rows))
    driven = levels[levels > 0]
    assert driven.min() >= lowest_level(0.4)
    assert driven.min() < 0.4
    assert driven.max() <= 1.0
    assert all(row[0] == 0.0 for row in rows)
