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
    commands = np.stack([staircase(0.25, HIGHEST, 8.0, STEP_S, rng) for _ in range(count)])
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
def posterior():
    """Return what two tests say."""
    return learn(measured(2, 0))


def duties_of(posterior):
    return Duties(posterior, 0.0, TRAVEL, HIGHEST, 8.0)


def test_fit_reaches_the_noise_of_the_sensor(posterior):
    assert posterior.rmse == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_no_test_leaves_more_open(posterior, seed):
    duties = duties_of(posterior)
    commands = draw_tests(posterior, 4, 4.0, HIGHEST, seed)
    _, slopes = free_run_slopes(posterior, commands, 0.0)
    before = duties.variance(posterior.precision)
    # Up to rounding of the solution, whose matrix has a condition of 1e9.
    after = [duties.variance(posterior.precision + information(posterior, rows)) for rows in slopes]
    assert max(after) <= before * (1 + 1e-6)


def test_a_fit_goes_on_from_the_last_one(posterior):
    later = learn(measured(4, 0), last=posterior)
    afresh = learn(measured(4, 0))
    assert later.rmse <= 1.01 * afresh.rmse


def test_nothing_is_known_before_the_first_test_but_the_prior(posterior):
    before = duties_of(posterior).variance(np.eye(len(posterior.position)) / PRIOR**2)
    assert before > 100 * duties_of(posterior).variance(posterior.precision)


def test_slopes_are_the_derivatives_of_the_free_run(posterior):
    commands = draw_tests(posterior, 3, 4.0, HIGHEST, 5)
    travel, slopes = free_run_slopes(posterior, commands, 0.0)
    direction = np.ones(len(posterior.position)) / len(posterior.position)
    step = 1e-6
    moved = replace(posterior, position=posterior.position + step * direction)
    difference = (free_run_slopes(moved, commands, 0.0)[0] - travel) / step
    scale = np.abs(slopes @ direction).max()
    # A forward difference is wrong by its step times the curvature, and by rounding over the step.
    assert np.abs(difference - slopes @ direction).max() < 1e-3 * scale


def test_chosen_test_beats_the_middle_of_the_candidates(posterior):
    duties, options = duties_of(posterior), {"start": 0.0, "available": TRAVEL}
    chosen = best_test(posterior, duties, **options, longest_s=8.0, overhead_s=1.0, seed=3)
    commands = draw_tests(posterior, CANDIDATES, 8.0, duties.highest, 3)
    travel, slopes = free_run_slopes(posterior, commands, 0.0)
    after = [
        duties.variance(posterior.precision + information(posterior, jacobian[: within(row, TRAVEL)]))
        for row, jacobian in zip(travel, slopes, strict=True)
    ]
    assert chosen.variance <= np.median(after)
    assert chosen.variance < duties.variance(posterior.precision)


def test_chosen_test_stays_within_travel_and_command(posterior):
    chosen = best_test(
        posterior,
        duties_of(posterior),
        start=0.0,
        available=100.0,
        longest_s=8.0,
        overhead_s=1.0,
        seed=1,
    )
    assert chosen.commands.max() <= HIGHEST
    assert chosen.commands.min() >= 0.0
    assert chosen.travel <= 100.0


def test_no_test_fits_where_there_is_no_way(posterior):
    options = {"start": 0.0, "available": 0.0, "longest_s": 8.0, "overhead_s": 1.0}
    # Not even for the shortest test: the piston moves within its first second.
    moving = [best_test(posterior, duties_of(posterior), **options, seed=seed) for seed in range(3)]
    assert all(choice is None or choice.travel <= 1e-9 for choice in moving)


def test_levels_come_once_each_from_below_the_dead_zone_to_the_highest():
    rows = [staircase(lowest_level(0.4), 1.0, 10.0, 0.01, np.random.default_rng(n)) for n in range(20)]
    levels = np.unique(np.concatenate(rows))
    driven = levels[levels > 0]
    assert driven.min() >= lowest_level(0.4)
    assert driven.min() < 0.4
    assert driven.max() <= 1.0
    assert all(row[0] == 0.0 for row in rows)
