"""A compensator for free run ships where it is better on tests it has not seen, and only there."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.identification import SpeedCompensatorConfig
from hitchid.identification.direction import operating_range_of
from hitchid.identification.held_out import HeldOut, folds_of
from hitchid.identification.speed_training import train_speed_compensator
from hitchid.logs.record import LIFTING
from hitchid.model import Channel
from hitchid.structures import Batch, PhysicalModel, structure_named
from truth import STEP_S, levels

SAMPLES, GAIN, NOISE = 240, 30.0, 0.02
SETTINGS = SpeedCompensatorConfig(units=3)
BENCHMARK = PhysicalModel(structure_named("integrator"), jnp.array([GAIN]), jnp.asarray(0.0))


def along_the_stroke(command, start):
    """Return the displacement of dx/dt = K u (1.3 − 0.6 (x − 60)/60), exact from sample to sample."""
    slope, position, displacement = -0.6 / 60, start, []
    for u in command:
        displacement.append(position)
        rate = GAIN * u * slope
        speed = GAIN * u * (1.3 + slope * (position - 60.0))
        position += speed * (np.expm1(rate * STEP_S) / rate if rate else STEP_S)
    return np.array(displacement)


def integrating(command, start):
    return start + STEP_S * GAIN * (np.cumsum(command) - command)


@pytest.fixture(scope="module")
def tests_of(make_record):
    """Return a function that gives tests of a plant with noise, each around its own level."""

    def make(plant, *, tests=12, seed=0, noise=NOISE):
        rng = np.random.default_rng(seed)
        records = []
        for top in np.linspace(0.5, 1.0, tests):
            command = top * levels(rng, SAMPLES, low=0.3)
            displacement = plant(command, rng.uniform(55.0, 75.0))
            records.append(make_record(displacement + noise * rng.standard_normal(SAMPLES), command))
        return Batch.of(records, LIFTING, dead_zone=0.0, sign=1)

    return make


def trained(batch, *, seed=0, covered=None):
    tests = batch.command.shape[0]
    channel = Channel(
        LIFTING, 1, 0.0, None, BENCHMARK, operating_range=covered or operating_range_of(batch, ())
    )
    held_out = tuple(HeldOut(fold, channel) for fold in folds_of(tests))
    return channel, train_speed_compensator(channel, held_out, batch, SETTINGS, seed)


@pytest.fixture(scope="module")
def learnt(tests_of):
    """Return tests of which the benchmark misses a part, its channel, and what training makes of them."""
    batch = tests_of(along_the_stroke)
    return batch, *trained(batch)


def free_run_errors(batch, displacement):
    """Return the root mean square error of each test over the samples that count, shape [T]."""
    errors, counted = np.asarray(displacement - batch.displacement), np.asarray(batch.loss_mask)
    return np.sqrt([np.mean(row[counts] ** 2) for row, counts in zip(errors, counted, strict=True)])


def test_a_speed_that_the_benchmark_misses_is_learnt_and_ships(learnt, tests_of):
    _, channel, judged = learnt
    test = judged.holdout_test
    assert test.accepted
    # What is missed is up to 30 % of the speed; three quarters of the error are gone on unseen tests.
    before, after = (np.sqrt(np.mean(errors**2)) for errors in (test.benchmark, test.compensated))
    assert after < 0.25 * before
    figures = f"cross-validation RMSE {before:.4g} without the network correction, {after:.4g} with it"
    better = np.count_nonzero(test.compensated < test.benchmark)
    assert test.sentence == f"network correction in free run: {figures}, smaller in {better} of 12 tests"
    mean, error = test.log_ratio
    assert mean + 2 * error < np.log(0.5)
    # And on tests of the same plant that nothing has seen.
    fresh = tests_of(along_the_stroke, tests=6, seed=1)
    corrected = replace(channel, speed_compensator=judged.compensator)
    errors = [free_run_errors(fresh, each.simulate(fresh)) for each in (corrected, channel)]
    # Half of the error: some of them leave the range of the tests it was fitted to.
    assert np.sqrt(np.mean(errors[0] ** 2)) < 0.5 * np.sqrt(np.mean(errors[1] ** 2))


def test_where_the_benchmark_is_the_truth_nothing_ships(tests_of):
    _, judged = trained(tests_of(integrating))
    assert judged.compensator is None
    assert not judged.holdout_test.accepted
    assert all(channel.speed_compensator is None for _, channel in judged.held_out)
    assert judged.holdout_test.sentence.startswith("no network correction in free run: ")
    # The initial displacement, a mean of six noisy samples, and white noise are all that is left.
    assert np.mean(judged.holdout_test.benchmark) == pytest.approx(NOISE * np.sqrt(1 + 1 / 6), rel=0.1)


def test_what_is_judged_is_what_ships(learnt):
    batch, channel, judged = learnt
    np.testing.assert_allclose(
        judged.holdout_test.benchmark, free_run_errors(batch, channel.simulate(batch)), rtol=1e-9
    )
    for fold, fold_channel in judged.held_out:
        assert fold_channel.speed_compensator.members == judged.compensator.members
        errors = free_run_errors(batch, fold_channel.simulate(batch))
        np.testing.assert_allclose(judged.holdout_test.compensated[fold], errors[fold], rtol=1e-9)


def test_samples_that_do_not_count_are_neither_learnt_nor_judged(learnt):
    batch = learnt[0]
    early = batch.masked(jnp.broadcast_to(jnp.arange(batch.command.shape[1]) < 150, batch.loss_mask.shape))
    spoilt = replace(early, displacement=jnp.where(early.loss_mask, early.displacement, 1e3))
    tests = [trained(batch)[1].holdout_test for batch in (early, spoilt)]
    np.testing.assert_array_equal(tests[0].benchmark, tests[1].benchmark)
    np.testing.assert_array_equal(tests[0].compensated, tests[1].compensated)


def test_a_test_changes_nothing_in_what_it_is_judged_by(learnt):
    batch, channel, judged = learnt
    first = judged.held_out[0]
    assert first.tests[0]
    changed = replace(batch, displacement=batch.displacement.at[0, 50:].add(0.1))
    second = trained(changed, covered=channel.operating_range)[1].held_out[0]
    networks = [fold.channel.speed_compensator.networks for fold in (first, second)]
    assert eqx.tree_equal(*networks)


@pytest.mark.parametrize("tests", [1, 2])
def test_too_few_tests_train_nothing_and_say_so(tests_of, tests):
    _, judged = trained(tests_of(along_the_stroke, tests=tests))
    assert judged.compensator is None
    assert judged.holdout_test.benchmark.size == judged.holdout_test.compensated.size == 0
    assert judged.holdout_test.sentence == "no network correction in free run: cross-validation needs 3 tests"


def test_one_seed_gives_the_same_weights_and_another_does_not(learnt):
    batch, _, judged = learnt
    again, other = (trained(batch, seed=seed)[1].compensator for seed in (0, 4))
    assert eqx.tree_equal(judged.compensator, again)
    assert np.any(again.networks.biases != other.networks.biases)
