"""Errors of strokes to second order: slopes against differences, sums against those of the free run."""

from dataclasses import replace

import numpy as np
import pytest

import handmade
import machine
from hitchid.live import Changes
from hitchid.live.stroke_errors import PIECES, SAMPLES, STOP_SHARE, StrokeErrors
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
    stroke, known = machine.stroke(mode, seed=1), errors_of[mode]
    (fit,) = known.fits([stroke], CHANGES)
    for number in range(2):
        step = STEPS * (np.arange(3) == number)
        tried = [Changes(*(np.array(CHANGES) + way * step)) for way in (0, 1, -1)]
        runs = known.runs(stroke, tried)
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


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_slopes_are_zero_where_there_is_no_spool(errors_of, mode):
    (fit,) = errors_of[mode].fits([machine.stroke(mode, seed=1)], CHANGES)
    assert (fit.gradient[2], *fit.information[2]) == 4 * (0.0,)


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_squares_of_free_runs_are_those_of_fits(errors_of, mode):
    stroke, known = machine.stroke(mode, seed=2), errors_of[mode]
    (fit,) = known.fits([stroke], CHANGES)
    runs = known.runs(stroke, [CHANGES, Changes()])
    of_run = runs.fit(0)
    for name in ("squares", "gradient", "information"):
        found, expected = np.asarray(getattr(of_run, name)), np.asarray(getattr(fit, name))
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert of_run.travel == pytest.approx(fit.travel, rel=1e-9)
    np.testing.assert_array_equal(of_run.at, fit.at)


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_at_the_changes_of_the_machine_nothing_is_left(errors_of, mode):
    machine_of = {"gain": np.exp(CHANGES.gain), "dead_zone": CHANGES.dead_zone}
    stroke = machine.stroke(mode, **machine_of)
    runs = errors_of[mode].runs(stroke, [CHANGES, Changes()])
    assert runs.mean_squares[0] < (1e3 * EPSILON * 100.0) ** 2  # rounding of 10³ sums of 100 mm
    assert runs.mean_squares[1] > 1.0
    np.testing.assert_allclose(
        runs.displacement[0][runs.measured], stroke.displacement[::FACTOR], rtol=1e3 * EPSILON
    )


def test_of_a_machine_like_the_model_each_piece_has_the_variance_of_the_sensor(errors_of):
    count, samples = 24, 140  # of each stroke, on the clock of the errors
    fits = [
        fit.over(NOISE**2)
        for seed in range(0, count, WINDOW)
        for fit in errors_of[LIFTING].fits(
            [machine.stroke(seed=seed + each) for each in range(WINDOW)], Changes()
        )
    ]
    # A mean of squares of normal errors over all strokes is off by √(2/n); the free run begins at a mean of
    # 51 samples at rest, which adds less than two of its variances.
    error = np.sqrt(2 / (count * samples)) + 2 / (REST + 1)
    assert np.mean([fit.squares for fit in fits]) == pytest.approx(PIECES, rel=4 * error)


@pytest.mark.parametrize("gain", [1.1, 0.9])
@pytest.mark.parametrize("mode", DIRECTIONS)
def test_the_speed_error_is_the_difference_of_the_gains_over_its_standard_deviation(errors_of, mode, gain):
    deviation, stroke = 0.3, machine.stroke(mode, gain=gain)  # mm
    (fit,) = errors_of[mode].fits([stroke], Changes())
    # The displacement is start + e^θ s with s of the model: its slope at 0 is s, its error (gain − 1) s.
    travel = (stroke.displacement[::FACTOR] - stroke.displacement[0]) / gain
    assert fit.travel == pytest.approx(np.abs(travel[-1]), rel=1e-9)
    known = PIECES * np.mean(travel**2) / deviation**2
    assert fit.over(deviation**2).information[0, 0] == pytest.approx(known, rel=1e-9)
    assert fit.over(deviation**2).speed_error == pytest.approx((gain - 1) * np.sqrt(known), rel=1e-9)


def test_strokes_are_on_a_clock_on_which_the_longest_has_its_place(errors_of):
    assert round(LONGEST_S / STEP_S) <= FACTOR * SAMPLES
    stroke = machine.stroke(seed=3)
    batch = errors_of[LIFTING].batch([stroke])
    assert batch.step_s == FACTOR * STEP_S
    assert batch.command.shape == (WINDOW, SAMPLES)
    used = len(stroke.displacement) // FACTOR
    command = np.asarray(batch.raw_command)[0]
    np.testing.assert_allclose(
        command[:used], stroke.commands[:, 0].reshape(-1, FACTOR).mean(axis=1), rtol=1e-15
    )
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
    found = [machine.stroke(seed=seed) for seed in range(WINDOW)]
    known = errors_of[LIFTING]
    together = known.fits(found, CHANGES)
    for number, stroke in enumerate(found):
        (alone,) = known.fits([stroke], CHANGES)
        assert alone.travel == pytest.approx(together[number].travel, rel=1e-12)
        for name in ("squares", "gradient", "information"):
            one, other = np.asarray(getattr(alone, name)), np.asarray(getattr(together[number], name))
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


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
    channel = replace(MODEL.channels[mode], end_stop=stop)
    whole = machine.stroke(mode)
    halted = whole._replace(
        displacement=channel.sign * np.minimum(channel.sign * whole.displacement, channel.sign * stop)
    )
    margin = STOP_SHARE * 120.0
    before = np.abs(whole.displacement[::FACTOR] - stop) > margin
    before &= np.abs(whole.displacement[::FACTOR] - 100.0) < 6.0
    known = StrokeErrors(channel, STEP_S, np.zeros(0), WINDOW)
    runs = known.runs(halted, [Changes()])
    np.testing.assert_array_equal(runs.measured[: before.size], before)
    assert 0 < before.sum() < before.size
    assert np.abs(runs.errors).max() < 1e3 * EPSILON * 100.0


def test_commands_that_are_missing_count_as_none(errors_of):
    stroke = machine.stroke(seed=5)
    commands = stroke.commands.copy()
    commands[:REST] = np.nan
    for name in ("squares", "gradient", "information"):
        (one,), (other,) = (
            errors_of[LIFTING].fits([each], CHANGES) for each in (stroke, stroke._replace(commands=commands))
        )
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_bands_of_a_free_run_are_as_wide_as_those_of_the_model():
    model = handmade.with_bands(MODEL, LIFTING, LOWERING)
    bands = model.bands[LIFTING]
    known = StrokeErrors(model.channels[LIFTING], STEP_S, np.zeros(0), WINDOW, bands)
    stroke = machine.stroke(start=100.0)
    half_width = known.half_width(stroke, Changes(), 0.9)
    floor = 1.6448536269514722 * bands.noise
    travel = np.zeros(SAMPLES)
    used = len(stroke.displacement) // FACTOR
    travel[:used], travel[used:] = stroke.displacement[::FACTOR] - 100.0, stroke.displacement[-1] - 100.0
    for factor in (1.0, 1.7):
        # The only member of the ensemble is a tenth faster.
        spread = factor * bands.multiplier(0.9) * (handmade.FASTER - 1) * travel
        np.testing.assert_allclose(half_width(factor), np.hypot(floor, spread), rtol=1e-9)
    assert (
        StrokeErrors(MODEL.channels[LIFTING], STEP_S, np.zeros(0), WINDOW).half_width(stroke, Changes(), 0.9)
        is None
    )
    assert bands.noise == NOISE
