"""Bands are calibrated on tests held out in turn: coverage of tests to come, few tests, divergence, units."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from hitchid.baselines.registry import delayed
from hitchid.errors import FitError
from hitchid.estimation.training import AdamConfig
from hitchid.identification import ModelSpec, MultiStart, held_out_training
from hitchid.identification.held_out import cross_fitted
from hitchid.identification.held_out_training import (
    CompensatorTraining,
    band_notices,
    calibrate_bands,
    with_compensators,
)
from hitchid.identification.mode_test import with_gain
from hitchid.identification.phase1 import identify_benchmark
from hitchid.identification.phase2 import CompensatorConfig, train_compensator
from hitchid.logs.record import LIFTING
from hitchid.model import Channel, EnsembleMember
from hitchid.model.bands import free_run_half_width
from hitchid.model.free_run import ensemble_deviations
from hitchid.model.load_filter import LoadFilter
from hitchid.networks.operating_range import OperatingRange
from hitchid.structures import Batch, structure_named
from hitchid.uncertainty.conformal import LEVELS
from truth import STEP_S, levels

GAIN, GAIN_SPREAD, NOISE = 20.0, 0.05, 0.05
SAMPLES, TESTS, SETS, TO_COME = 200, 12, 8, 40
SPEC = ModelSpec(structure_named("integrator"))
SURE = 3.3  # standard errors, beyond which 1 in 1000 lies


def exchangeable(make_record, rng, count, *, scale=1.0):
    """Return exchangeable tests of integrators whose gains scatter, with white noise of the sensor."""
    records = []
    for gain in GAIN * (1 + GAIN_SPREAD * rng.standard_normal(count)):
        command = levels(rng, SAMPLES, low=0.3)
        travel = gain * STEP_S * np.concatenate([[0.0], np.cumsum(command)[:-1]])
        displacement = 80.0 + travel + NOISE * rng.standard_normal(SAMPLES)
        records.append(make_record(scale * displacement, command))
    return Batch.of(records, LIFTING, dead_zone=0.0, sign=1, initial=[scale * 80.0] * count)


def calibrated(batch):
    """Return a channel identified from tests, its first phase, and its bands."""
    search = MultiStart(evaluations=20, starts=1)
    phase1 = identify_benchmark(batch, SPEC, search, 0, units={"x": "mm", "u": "A"})
    channel = Channel(LIFTING, 1, 0.0, None, phase1.benchmark, operating_range=OperatingRange.unbounded())
    return channel, phase1, calibrate_bands(channel, phase1, batch, cross_fitted(channel, phase1))


def covered(channel, bands, batch, coverage):
    """Return the share of samples of tests that lie within the band of a free run."""
    simulated, deviations = ensemble_deviations(channel, bands.ensemble, batch)
    half_width = free_run_half_width([bands], [np.sqrt(np.sum(deviations**2, axis=0))], coverage)
    inside = np.abs(np.asarray(batch.displacement) - simulated) <= half_width
    return float(np.mean(inside[np.asarray(batch.loss_mask)]))


def test_noise_is_the_sensors_and_bands_widen_with_their_level(make_record):
    _, _, bands = calibrated(exchangeable(make_record, np.random.default_rng(1), TESTS))
    # Ten thousand differences of the noise: 3 % at three standard errors.
    assert bands.noise == pytest.approx(NOISE, rel=0.05)
    assert bands.tests == (TESTS, TESTS)
    assert list(bands.free_run) == sorted(bands.free_run)
    # Of a piston at rest only the noise is uncertain, at its last measurement and now.
    widths = np.array([[bands.half_width(level, h, np.zeros(())) for level in LEVELS] for h in (1, 10, 100)])
    assert np.all(np.diff(widths, axis=1) >= 0)
    assert widths[0, 2] == pytest.approx(np.sqrt(2) * stats.norm.ppf(0.95) * NOISE, rel=0.1)
    # A gain that scatters by 5 % gives an error of 5 % of the movement.
    assert bands.predictions.exponent == 1.0
    spread = bands.predictions.spread(100, np.array([1.0, 10.0]))
    assert spread[1] / 10.0 == pytest.approx(GAIN_SPREAD, rel=0.7)


def test_tests_to_come_are_covered_to_the_level(make_record):
    rng, horizons = np.random.default_rng(0), (1, 7, 30, 100)
    free_runs, predictions = {0.8: [], 0.9: []}, []
    for _ in range(SETS):
        channel, _, bands = calibrated(exchangeable(make_record, rng, TESTS))
        to_come = exchangeable(make_record, rng, TO_COME)
        for level, shares in free_runs.items():
            shares.append(covered(channel, bands, to_come, level))
        measured, shares = np.asarray(to_come.displacement), []
        for horizon, predicted in zip(horizons, np.asarray(channel.predict(to_come, horizons)), strict=True):
            half_width = bands.half_width(0.9, horizon, predicted - delayed(measured, horizon))
            inside = np.abs(measured - predicted) <= half_width
            shares.append(np.mean(inside[:, horizon:SAMPLES]))
        predictions.append(shares)
    # Samples of a test hang together: the level is met to within one test, and the mean of sets scatters
    # as a Beta(k, T + 1 - k) number does. Between the calibrated horizons the half width is interpolated.
    for level, shares in (*free_runs.items(), *((0.9, row) for row in zip(*predictions, strict=True))):
        error = np.sqrt(level * (1 - level) / (TESTS + 2) / SETS)
        assert abs(np.mean(shares) - level) <= 1 / (TESTS + 1) + SURE * error


@pytest.mark.parametrize(
    ("count", "words"),
    [
        (2, "no bands around predictions: they require 3 tests, there are 2"),
        (3, "3 tests are too few to calibrate bands for 80 % (4 tests) and 90 % (9 tests)"),
        (16, "16 tests are too few to calibrate bands for 95 % (19 tests)"),
    ],
)
def test_what_too_few_tests_cannot_calibrate_is_said(count, words):
    (notice,) = band_notices(count)
    assert notice.startswith(words)
    assert band_notices(19) == []


def test_every_test_is_held_out_once_from_a_fit(make_record):
    batch = exchangeable(make_record, np.random.default_rng(9), TESTS)
    channel, phase1, _ = calibrated(batch)
    held_out = cross_fitted(channel, phase1)
    np.testing.assert_array_equal(np.sum([tests for tests, _ in held_out], axis=0), np.ones(TESTS))
    for tests, fold_channel in held_out:
        others = batch.take(np.flatnonzero(~tests).tolist())
        errors = np.asarray(fold_channel.simulate(others) - others.displacement)
        travel = np.asarray(fold_channel.simulate(others)) - 80.0
        # Least squares: the errors of the tests it was fitted to are orthogonal to the gain's derivative.
        mask = np.asarray(others.loss_mask)
        gradient = np.sum((errors * travel)[mask]) / np.sum((travel**2)[mask])
        assert abs(gradient) < 1e-3


def test_a_compensator_is_trained_without_the_fold(make_record):
    batch = exchangeable(make_record, np.random.default_rng(10), 4)
    channel, phase1, _ = calibrated(batch)
    settings = CompensatorConfig(hidden=2, window=20, adam=AdamConfig(epochs=4, batch=8))
    travel = channel.simulate_benchmark(batch)
    compensator, _ = train_compensator(
        (batch, travel), (batch, travel), LoadFilter.none(), settings, jax.random.key(0)
    )
    channel = replace(channel, compensator=compensator)
    training = CompensatorTraining(settings, 3, jax.random.key(1))

    def trained(tests):
        return with_compensators(cross_fitted(channel, phase1), tests, training)[0].channel.compensator

    spoilt = batch.displacement.at[0].add(jnp.where(jnp.arange(batch.command.shape[1]) > 50, 5.0, 0.0))
    first, second = trained(batch), trained(replace(batch, displacement=spoilt))
    # The first test is held out: what happened in it does not matter; the benchmark is refitted without it.
    assert eqx.tree_equal(first, second, rtol=1e-4, atol=1e-5)
    assert not eqx.tree_equal(first.network, compensator.network)


def test_an_ensemble_member_that_diverges_is_left_out(make_record, monkeypatch):
    channel, phase1, bands = calibrated(exchangeable(make_record, np.random.default_rng(5), 4))
    found = held_out_training._ensemble(channel, phase1)
    endless = replace(found[0], benchmark=tuple(np.full_like(found[0].benchmark, np.inf)))
    monkeypatch.setattr(held_out_training, "_ensemble", lambda *_: [*found, endless])
    batch = phase1.fit.objective.batch
    held_out = cross_fitted(channel, phase1)
    assert calibrate_bands(channel, phase1, batch, held_out) == bands


def test_bands_are_in_the_displacement_s_unit(make_record):
    metres, millimetres = (
        calibrated(exchangeable(make_record, np.random.default_rng(6), 6, scale=scale))[2]
        for scale in (1e-3, 1.0)
    )
    assert metres.noise == pytest.approx(1e-3 * millimetres.noise, rel=1e-6)
    np.testing.assert_allclose(metres.free_run, millimetres.free_run, rtol=1e-4)
    for horizon in (1, 30):
        expected = 1e-3 * millimetres.half_width(0.9, horizon, np.array(2.0))
        assert metres.half_width(0.9, horizon, np.array(2e-3)) == pytest.approx(expected, rel=1e-4)


def test_a_member_of_the_ensemble_is_a_standard_error_away(make_record):
    channel, phase1, _ = calibrated(exchangeable(make_record, np.random.default_rng(7), TESTS))
    (member,) = held_out_training._ensemble(channel, phase1)
    assert isinstance(member, EnsembleMember)
    (estimate,) = phase1.parameter_estimates
    # The step is taken in the logarithm of the gain.
    step = abs(np.log(member.benchmark[0] / estimate.value))
    assert step == pytest.approx(estimate.error / estimate.value, rel=1e-6)
    # A gain that was calibrated on whole logs carries its factor over to the members.
    scaled = replace(channel, benchmark=channel.benchmark.with_gain(1.05))
    (moved,) = held_out_training._ensemble(scaled, phase1)
    assert moved.benchmark[0] == pytest.approx(1.05 * member.benchmark[0], rel=1e-12)
    assert jnp.isfinite(scaled.benchmark.gain)


def test_a_band_wider_than_the_range_is_none(make_record):
    batch = exchangeable(make_record, np.random.default_rng(1), 3)
    channel, phase1, _ = calibrated(batch)
    # Of models fitted without a fold that run far away, errors say nothing of where a piston is.
    lost = [each._replace(channel=with_gain(each.channel, 50.0)) for each in cross_fitted(channel, phase1)]
    with pytest.raises(FitError, match=r"no band can be given: of 90 % it would be .* wide on average"):
        calibrate_bands(channel, phase1, batch, lost)
