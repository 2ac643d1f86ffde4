"""Bands are calibrated on tests held out in turn: coverage of tests to come, few tests, divergence, units."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.data.record import LIFTING
from hitchid.identification import ModelSpec, MultiStart, band_calibration
from hitchid.identification.band_calibration import FEWEST_TESTS, calibrate_bands
from hitchid.identification.phase1 import identify_benchmark
from hitchid.model import Channel, EnsembleMember
from hitchid.model.bands import free_run_half_width
from hitchid.model.ensemble import ensemble_deviations
from hitchid.networks.operating_range import OperatingRange
from hitchid.structures import Batch, structure_named
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
    return channel, phase1, calibrate_bands(channel, phase1, batch, batch)


def covered(channel, bands, batch, coverage):
    """Return the share of samples of tests that lie within the band of a free run."""
    simulated, deviations = ensemble_deviations(channel, bands.ensemble, batch)
    half_width = free_run_half_width([bands], [np.sqrt(np.sum(deviations**2, axis=0))], coverage)
    inside = np.abs(np.asarray(batch.displacement) - simulated) <= half_width
    return float(np.mean(inside[np.asarray(batch.loss_mask)]))


def test_the_noise_is_that_of_the_sensor_and_bands_widen_with_level_and_horizon(make_record):
    _, _, bands = calibrated(exchangeable(make_record, np.random.default_rng(1), TESTS))
    # Ten thousand differences of the noise: 3 % at three standard errors.
    assert bands.noise == pytest.approx(NOISE, rel=0.05)
    assert bands.tests == (TESTS, TESTS)
    assert list(bands.free_run) == sorted(bands.free_run)
    widths = np.array(
        [[bands.half_width(level, horizon) for level in bands.levels] for horizon in (1, 10, 100)]
    )
    assert np.all(np.diff(widths, axis=1) >= 0)
    # Without a compensator a prediction is the free run, whatever it may use.
    np.testing.assert_allclose(widths[0], widths[1], rtol=0.2)


def test_tests_to_come_are_covered_to_the_level(make_record):
    rng = np.random.default_rng(0)
    shares = {0.8: [], 0.9: []}
    for _ in range(SETS):
        channel, _, bands = calibrated(exchangeable(make_record, rng, TESTS))
        to_come = exchangeable(make_record, rng, TO_COME)
        for level, rows in shares.items():
            rows.append(covered(channel, bands, to_come, level))
    for level, rows in shares.items():
        # Samples of a test hang together: the level is met to within one test, and the mean of sets scatters
        # as a Beta(k, T + 1 - k) number does.
        error = np.sqrt(level * (1 - level) / (TESTS + 2) / SETS)
        assert abs(np.mean(rows) - level) <= 1 / (TESTS + 1) + SURE * error


@pytest.mark.parametrize("count", [1, FEWEST_TESTS - 1])
def test_too_few_tests_give_no_bands(make_record, count):
    _, _, bands = calibrated(exchangeable(make_record, np.random.default_rng(2), count))
    assert bands is None


def test_few_tests_are_enough_and_their_band_holds_each_of_them(make_record):
    batch = exchangeable(make_record, np.random.default_rng(3), FEWEST_TESTS)
    channel, _, bands = calibrated(batch)
    assert bands.tests == (FEWEST_TESTS, FEWEST_TESTS)
    # No level above 3/4 is known from three tests: the largest score stands for it.
    assert covered(channel, bands, batch, 0.95) >= 0.95


def test_one_validation_test_gives_horizons_the_largest_error_of_its_quantiles(make_record):
    batch = exchangeable(make_record, np.random.default_rng(4), 4)
    channel, phase1, _ = calibrated(batch)
    one = batch.take([0])
    bands = calibrate_bands(channel, phase1, batch, one)
    assert bands.tests == (4, 1)
    errors = np.abs(np.asarray(one.displacement) - np.asarray(channel.predict(one, (10,)))[0])[0, 10:SAMPLES]
    assert bands.half_width(0.9, 10) == pytest.approx(errors.max(), rel=1e-9)


def test_an_ensemble_member_that_diverges_is_left_out(make_record, monkeypatch):
    channel, phase1, bands = calibrated(exchangeable(make_record, np.random.default_rng(5), 4))
    found = band_calibration._ensemble(channel, phase1)
    endless = replace(found[0], benchmark=tuple(np.full_like(found[0].benchmark, np.inf)))
    monkeypatch.setattr(band_calibration, "_ensemble", lambda *_: [*found, endless])
    batch = phase1.fit.objective.batch
    assert calibrate_bands(channel, phase1, batch, batch) == bands


def test_bands_are_in_the_displacement_s_unit(make_record):
    metres, millimetres = (
        calibrated(exchangeable(make_record, np.random.default_rng(6), 6, scale=scale))[2]
        for scale in (1e-3, 1.0)
    )
    assert metres.noise == pytest.approx(1e-3 * millimetres.noise, rel=1e-6)
    np.testing.assert_allclose(metres.free_run, millimetres.free_run, rtol=1e-4)
    for horizon in (1, 30):
        expected = 1e-3 * millimetres.half_width(0.9, horizon)
        assert metres.half_width(0.9, horizon) == pytest.approx(expected, rel=1e-4)


def test_a_member_is_a_standard_error_away_or_as_far_as_bounds_allow(make_record):
    channel, phase1, _ = calibrated(exchangeable(make_record, np.random.default_rng(7), TESTS))
    (member,) = band_calibration._ensemble(channel, phase1)
    assert isinstance(member, EnsembleMember)
    (estimate,) = phase1.parameter_estimates
    # The step is taken in the logarithm of the gain.
    step = abs(np.log(member.benchmark[0] / estimate.value))
    assert step == pytest.approx(estimate.error / estimate.value, rel=1e-6)
    # A gain that was calibrated on whole logs carries its factor over to the members.
    scaled = replace(channel, benchmark=channel.benchmark.with_gain(1.05))
    (moved,) = band_calibration._ensemble(scaled, phase1)
    assert moved.benchmark[0] == pytest.approx(1.05 * member.benchmark[0], rel=1e-12)
    assert jnp.isfinite(scaled.benchmark.gain)
