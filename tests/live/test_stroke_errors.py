"""Errors of strokes: slopes against differences, sums against free runs, and limits of the speed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handmade
import machine
from hitchid.live import Changes
from hitchid.live.stroke_errors import LIMITS, PIECES, SAMPLES, STOP_SHARE, StrokeErrors, speed_limit
from hitchid.live.strokes import LONGEST_S
from hitchid.logs.record import LIFTING, LOWERING
from machine import DIRECTIONS, MODEL, NOISE, REST, STEP_S

WINDOW = 4
FACTOR = 2  # a stroke of 20 s at 100 Hz has 2000 samples, of which 1024 are kept
EPSILON = float(np.finfo(np.float64).eps)
CHANGES = Changes(0.1, -0.02, 0.0)
STEPS = np.array([1e-4, 1e-4, 0.0])  # log gain, A


@pytest.fixture(scope="module")
def errors_of():
    """Return the errors of each direction."""
    return {
        mode: StrokeErrors(channel, STEP_S, np.zeros(0), WINDOW) for mode, channel in MODEL.channels.items()
    }


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_gradient_and_information_are_those_of_differences(errors_of, mode):
    stroke, errors = machine.stroke(mode, seed=1), errors_of[mode]
    (fit,) = errors.fits([stroke], CHANGES)
    for number in range(2):
        step = STEPS * (np.arange(3) == number)
        tried = [Changes(*(np.array(CHANGES) + way * step)) for way in (0, 1, -1)]
        runs = errors.runs(stroke, tried)
        size = STEPS[number]
        # Central differences: off by the third derivative times the step squared, a relative 10⁻⁸, and by
        # the rounding of the sums over the step.
        rounding = 100 * EPSILON / size
        slope = (runs.squares[1] - runs.squares[2]) / (2 * size)
        scale = np.sqrt(fit.squares * fit.information[number, number])
        assert slope == pytest.approx(-2 * fit.gradient[number], abs=(10 * size**2 + rounding) * scale)
        change = (runs.gradients[2] - runs.gradients[1]) / (2 * size)
        scales = np.sqrt(fit.information[number, number] * np.diag(fit.information))
        np.testing.assert_array_less(
            np.abs(change - fit.information[number]), (10 * size**2 + rounding) * scales + EPSILON
        )


def assert_alike(one, other, tolerance=1e-9):
    """Check that two fits have the same sums."""
    for name in ("squares", "gradient", "information"):
        own, expected = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        np.testing.assert_allclose(own, expected, rtol=tolerance, atol=tolerance * np.abs(expected).max())


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_squares_of_free_runs_are_those_of_fits(errors_of, mode):
    stroke, errors = machine.stroke(mode, seed=2), errors_of[mode]
    (fit,) = errors.fits([stroke], CHANGES)
    of_run = errors.runs(stroke, [CHANGES, Changes()]).fit(0)
    assert_alike(of_run, fit)
    assert of_run.travel == pytest.approx(fit.travel, rel=1e-9)
    np.testing.assert_array_equal(of_run.at, fit.at)
    assert (fit.gradient[2], *fit.information[2]) == 4 * (0.0,)  # where there is no spool


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_at_the_changes_of_the_machine_nothing_is_left(errors_of, mode):
    stroke = machine.stroke(mode, gain=np.exp(CHANGES.gain), dead_zone=CHANGES.dead_zone)
    runs = errors_of[mode].runs(stroke, [CHANGES, Changes()])
    assert runs.mean_squares[0] < (1e3 * EPSILON * 100.0) ** 2  # rounding of 10³ sums of 100 mm
    assert runs.mean_squares[1] > 1.0
    simulated = runs.displacement[0][runs.measured]
    np.testing.assert_allclose(simulated, stroke.displacement[::FACTOR], rtol=1e3 * EPSILON)


def test_each_piece_has_the_variance_of_the_sensor(errors_of):
    """Of a machine like the model."""
    count, samples = 24, 140  # of each stroke, on the clock of the errors
    strokes = [machine.stroke(seed=seed) for seed in range(count)]
    windows = [strokes[first : first + WINDOW] for first in range(0, count, WINDOW)]
    fits = [fit for window in windows for fit in errors_of[LIFTING].fits(window, Changes())]
    # A mean of squares of normal errors over all strokes is off by √(2/n); the free run begins at a mean of
    # 51 samples at rest, which adds less than two of its variances.
    error = np.sqrt(2 / (count * samples)) + 2 / (REST + 1)
    assert np.mean([fit.over(NOISE**2).squares for fit in fits]) == pytest.approx(PIECES, rel=4 * error)


@pytest.mark.parametrize("gain", [1.1, 0.9])
@pytest.mark.parametrize("mode", DIRECTIONS)
def test_the_speed_error_is_the_standardised_difference_of_gains(errors_of, mode, gain):
    deviation, stroke = 0.3, machine.stroke(mode, gain=gain)  # mm
    (fit,) = errors_of[mode].fits([stroke], Changes())
    # The displacement is start + e^θ s with s of the model: its slope at 0 is s, its error (gain − 1) s.
    travel = (stroke.displacement[::FACTOR] - stroke.displacement[0]) / gain
    assert fit.travel == pytest.approx(np.abs(travel[-1]), rel=1e-9)
    expected, fit = PIECES * np.mean(travel**2) / deviation**2, fit.over(deviation**2)
    assert fit.information[0, 0] == pytest.approx(expected, rel=1e-9)
    assert fit.speed_error == pytest.approx((gain - 1) * np.sqrt(expected), rel=1e-9)


def test_strokes_are_on_a_clock_that_holds_the_longest(errors_of):
    assert round(LONGEST_S / STEP_S) <= FACTOR * SAMPLES
    stroke = machine.stroke(seed=3)
    batch = errors_of[LIFTING].batch([stroke])
    assert batch.step_s == FACTOR * STEP_S
    assert batch.command.shape == (WINDOW, SAMPLES)
    used = len(stroke.displacement) // FACTOR
    means = stroke.commands[:, 0].reshape(-1, FACTOR).mean(axis=1)
    np.testing.assert_allclose(np.asarray(batch.raw_command)[0, :used], means, rtol=1e-15)
    np.testing.assert_array_equal(np.asarray(batch.displacement)[0, :used], stroke.displacement[::FACTOR])
    assert np.asarray(batch.valid)[0].sum() == used
    assert float(batch.initial[0]) == pytest.approx(stroke.displacement[: REST + 1].mean(), rel=1e-12)


@pytest.mark.parametrize("odd", [0, 1])
def test_the_longest_stroke_is_run_to_its_end(errors_of, odd):
    samples = round(LONGEST_S / STEP_S) - REST - odd
    commands = np.zeros((REST + samples, 2))
    commands[REST:, 0] = machine.DEAD_ZONES[LIFTING] + 0.1
    stroke = machine.stroke()._replace(commands=commands, displacement=machine.moved(20.0, commands))
    runs = errors_of[LIFTING].runs(stroke, [Changes()])
    assert runs.measured.sum() == -(-(REST + samples) // FACTOR)
    assert np.abs(runs.errors).max() < 1e3 * EPSILON * 100.0


def test_what_fills_up_the_window_has_no_weight(errors_of):
    strokes = [machine.stroke(seed=seed) for seed in range(WINDOW)]
    for stroke, fit in zip(strokes, errors_of[LIFTING].fits(strokes, CHANGES), strict=True):
        (alone,) = errors_of[LIFTING].fits([stroke], CHANGES)
        assert alone.travel == pytest.approx(fit.travel, rel=1e-12)
        assert_alike(alone, fit)


def test_samples_that_are_missing_have_no_weight(errors_of):
    whole = machine.stroke(seed=4)
    missing = np.zeros(len(whole.displacement), bool)
    missing[60:100] = True
    gappy = whole._replace(displacement=np.where(missing, np.nan, whole.displacement))
    (fit,) = errors_of[LIFTING].fits([gappy], CHANGES)
    runs = errors_of[LIFTING].runs(gappy, [CHANGES])
    assert runs.measured.sum() == (~missing[::FACTOR]).sum()
    assert np.all(runs.errors[0, : len(missing) // FACTOR][missing[::FACTOR]] == 0.0)
    assert np.isfinite([fit.squares, *fit.gradient, *fit.information.ravel()]).all()
    assert fit.squares == pytest.approx(PIECES * runs.mean_squares[0], rel=1e-9)


@pytest.mark.parametrize(("mode", "stop"), [(LIFTING, 106.0), (LOWERING, 94.0)])
def test_samples_from_a_known_end_stop_on_have_no_weight(mode, stop):
    channel, whole = replace(MODEL.channels[mode], end_stop=stop), machine.stroke(mode)
    sign = channel.sign
    halted = whole._replace(displacement=sign * np.minimum(sign * whole.displacement, sign * stop))
    before = np.abs(whole.displacement[::FACTOR] - stop) > STOP_SHARE * 120.0
    before &= np.abs(whole.displacement[::FACTOR] - 100.0) < 6.0
    runs = StrokeErrors(channel, STEP_S, np.zeros(0), WINDOW).runs(halted, [Changes()])
    np.testing.assert_array_equal(runs.measured[: before.size], before)
    assert 0 < before.sum() < before.size
    assert np.abs(runs.errors).max() < 1e3 * EPSILON * 100.0


def test_commands_that_are_missing_count_as_none(errors_of):
    stroke = machine.stroke(seed=5)
    commands = np.where(np.arange(len(stroke.commands))[:, None] < REST, np.nan, stroke.commands)
    ((one,), (other,)) = (
        errors_of[LIFTING].fits([own], CHANGES) for own in (stroke, stroke._replace(commands=commands))
    )
    assert_alike(one, other, tolerance=0.0)


def test_bands_are_as_wide_as_those_of_the_model(errors_of):
    model = handmade.with_bands(MODEL, LIFTING, LOWERING)
    bands, stroke = model.bands[LIFTING], machine.stroke(start=100.0)
    errors = StrokeErrors(model.channels[LIFTING], STEP_S, np.zeros(0), WINDOW, bands)
    half_width = errors.half_width(stroke, Changes(), 0.9)
    floor = 1.6448536269514722 * NOISE
    used = len(stroke.displacement) // FACTOR
    travel = np.full(SAMPLES, stroke.displacement[-1] - 100.0)
    travel[:used] = stroke.displacement[::FACTOR] - 100.0
    for factor in (1.0, 1.7):
        # The only member of the ensemble is a tenth faster.
        spread = factor * bands.multiplier(0.9) * (handmade.FASTER - 1) * travel
        np.testing.assert_allclose(half_width(factor), np.hypot(floor, spread), rtol=1e-9)
    assert errors_of[LIFTING].half_width(stroke, Changes(), 0.9) is None


# --- limits of the speed ------------------------------------------------------------------------------------

VARIANCE = NOISE**2 + (0.01 * 20.0) ** 2  # mm²: a hundredth of a travel of 20 mm is the usual misfit
GAINS = np.log(np.linspace(0.5, 1.2, 71))  # of which one fits a stroke to half a percent


def limited(stroke, limit, seed):
    """Return a stroke whose speed is at most a share of its fastest, with the noise of the sensor."""
    speed = np.diff(stroke.displacement, prepend=stroke.displacement[0])
    moved = stroke.displacement[0] + np.cumsum(np.minimum(speed, limit * speed.max()))
    noise = NOISE * np.random.default_rng(seed).standard_normal(moved.size)
    return stroke._replace(displacement=moved + noise)


def limit_of(errors_of, stroke):
    """Return the limit of speed that explains a stroke better than the best of the gains."""
    runs = errors_of[LIFTING].runs(stroke, [Changes(), *(Changes(float(gain)) for gain in GAINS)])
    return speed_limit(runs, 0, 1 + int(np.argmin(runs.mean_squares[1:])), VARIANCE)


@pytest.mark.parametrize("limit", [0.4, 0.6, 0.8])
def test_the_limit_is_that_of_the_machine(errors_of, limit):
    stroke = limited(machine.stroke(levels=(0.15, 0.45)), limit, seed=2)
    # The limits that are tried are 0.025 apart.
    assert limit_of(errors_of, stroke) == pytest.approx(limit, abs=LIMITS[1] - LIMITS[0])


@given(st.floats(0.6, 1.2), st.floats(0.1, 0.45), st.floats(0.1, 0.45), st.integers(0, 1000))
def test_another_gain_is_no_limit_whatever_the_levels(errors_of, gain, first, second, seed):
    assert limit_of(errors_of, machine.stroke(levels=(first, second), gain=gain, seed=seed)) == 1.0


def test_at_one_level_a_limit_is_another_gain(errors_of):
    assert limit_of(errors_of, limited(machine.stroke(levels=(0.3, 0.3)), 0.7, seed=2)) == 1.0
