"""The linear model about an operating point: transfer function, draws, and play against a simulated one."""

from dataclasses import replace

import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.handover.linear import describing_function
from hitchid.handover.responses import frequency_response
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Estimates, Uncertainty
from report import reported

DEAD_TIME_S = 0.0317
SPREAD = 0.1  # standard error of the logarithm of the gain
DRAWS = 2000
FREQUENCY_HZ = np.geomspace(0.05, 10.0, 25)


def uncertain(model, spread=SPREAD):
    """Return a model whose gain in each direction has a standard error, unless its spread is None."""
    known = {}
    for direction in model.channels:
        gain = handmade.GAINS[direction]
        estimate = reported.estimate(value=gain, error=spread and spread * gain, interval=(None, None))
        known[direction] = Uncertainty(Estimates((estimate,), (), ((1.0,),), 5, 5))
    return replace(model, uncertainty=known)


def response(found):
    """Return the complex frequency response."""
    return found.magnitude.value * np.exp(1j * found.phase_rad.value)


def of_matrices(system, frequencies):
    """Return C (s − A)⁻¹ B at complex frequencies."""
    identity = np.eye(len(system.A))
    return np.array(
        [(system.C @ np.linalg.solve(s * identity - system.A, system.B)).item() for s in frequencies]
    )


@pytest.mark.parametrize("direction", [LIFTING, LOWERING])
def test_without_nonlinearities_it_is_the_channels_response(direction):
    model = handmade.hitch("integrator-second-order", dead_time_s=DEAD_TIME_S)
    linear = model.linearise(direction)
    found = linear.frequency_response(FREQUENCY_HZ)
    # Which is compared with scipy's in `test_responses.py`.
    expected = frequency_response(model.channels[direction], FREQUENCY_HZ, None, None)
    np.testing.assert_allclose(response(found), response(expected), rtol=1e-9)
    assert linear.gain.value == pytest.approx(linear.sign * handmade.GAINS[direction], rel=1e-12)
    assert linear.drawn is None
    assert linear.models() == ()


def test_the_continuous_model_has_the_dead_time_up_to_its_approximation():
    model = handmade.hitch("integrator-second-order", dead_time_s=DEAD_TIME_S)
    linear = model.linearise(LIFTING)
    slow = FREQUENCY_HZ[2 * np.pi * FREQUENCY_HZ * DEAD_TIME_S < 1]
    exact = response(linear.frequency_response(slow))
    # The approximant of order n departs in phase by 2 (n!)² x^(2n+1)/((2n)! (2n+1)!): 8e-8 rad at x = 1.
    np.testing.assert_allclose(of_matrices(linear.to_scipy(), 2j * np.pi * slow), exact, rtol=1e-7)


def test_drawn_models_have_the_spread_of_the_estimates_and_the_rest_of_the_model():
    model = uncertain(handmade.hitch("integrator-first-order", dead_time_s=DEAD_TIME_S))
    linear = model.linearise(LOWERING, draws=DRAWS)
    logarithms = np.log(np.abs(linear.drawn.gain * linear.drawn.b[:, -1]))
    # Standard error of a standard deviation over the draws; five of them.
    assert logarithms.std() / SPREAD == pytest.approx(1, abs=5 / np.sqrt(2 * DRAWS))
    gain = linear.gain
    assert gain.lower < gain.value < gain.upper < 0
    # Quantiles of a log-normal gain, with their standard error √(q (1 − q)/n)/φ(z) = 0.06 deviations; five.
    for found, quantile in ((gain.upper, -1.96), (gain.lower, 1.96)):
        assert np.log(found / gain.value) / SPREAD == pytest.approx(quantile, abs=0.3)
    band = linear.frequency_response(FREQUENCY_HZ).magnitude
    np.testing.assert_allclose(band.upper / band.value, gain.lower / gain.value, rtol=1e-9)
    # At 10 ms, too, a drawn model differs by its gain alone.
    models, z = linear.models(0.01), np.exp(0.02j * np.pi * FREQUENCY_HZ)
    assert len(models) == DRAWS
    ratio = of_matrices(models[0].to_scipy(), z) / of_matrices(linear.to_scipy(0.01), z)
    expected = (linear.drawn.gain * linear.drawn.b[:, -1])[0] / (
        linear.small_signal.gain * linear.small_signal.b[-1]
    )
    np.testing.assert_allclose(ratio, expected, rtol=1e-9)


def test_a_model_without_standard_errors_has_no_draws():
    model = uncertain(handmade.hitch("integrator-first-order"), spread=None)
    linear = model.linearise(LIFTING)
    assert linear.drawn is None
    assert linear.gain.lower is None


def test_the_gain_is_the_slope_of_the_steady_speed_at_the_operating_point():
    model = handmade.hitch_of(handmade.channel(LIFTING, "integrator-second-order", shape=True))
    at = {"displacement": 90.0, "load": 130.0}
    step = 1e-5
    above, below = (model.speed(0.9 + move, **at).speed for move in (step, -step))
    linear = model.linearise(command=0.9, **at)
    # A central difference: third derivative and rounding of a speed of about 5 mm/s over 2e-5 A.
    assert linear.gain.value == pytest.approx((above - below) / (2 * step), rel=1e-6)
    assert (linear.command, linear.displacement) == (0.9, 90.0)
    assert list(linear.load.values()) == [130.0]
    assert "0.9 A, 90 mm" in repr(linear)


def test_the_describing_function_is_the_fundamental_of_a_simulated_play():
    samples, periods, play, amplitude = 20_000, 2, 0.03, 0.05
    angle = 2 * np.pi * np.arange(periods * samples) / samples
    output, followed = 0.0, []
    for value in amplitude * np.sin(angle):
        output = float(np.clip(output, value - play, value + play))
        followed.append(output)
    last = slice(samples, None)
    fundamental = 2 * np.mean(np.array(followed)[last] * np.exp(-1j * angle[last])) * 1j
    # A sum in place of the integral over a kinked function: an error of the second order in 2π/N.
    assert describing_function(play, amplitude) == pytest.approx(fundamental / amplitude, rel=1e-6)
    assert describing_function(0.0, amplitude) == 1
    assert describing_function(play, play) == 0


def test_a_sine_within_the_play_moves_nothing_and_a_large_one_as_if_there_were_none():
    model = handmade.hitch_of(handmade.channel(LIFTING, "integrator-first-order", shape=True))
    linear = model.linearise(load=120.0)
    assert linear.play > 0
    passed, within, large = (
        linear.frequency_response(FREQUENCY_HZ, amplitude=amplitude)
        for amplitude in (None, linear.play, 1e6 * linear.play)
    )
    assert np.all(within.magnitude.value == 0)
    # 1 − |N| and its phase are of the order 4 δ/(π A) and below.
    np.testing.assert_allclose(response(large), response(passed), rtol=4e-6)


def test_bad_arguments_are_named():
    model = handmade.hitch("integrator-first-order")
    with pytest.raises(InputError, match="draws: expected a whole number"):
        uncertain(model).linearise(LIFTING, draws=-1)
    with pytest.raises(InputError, match="frequency_hz"):
        model.linearise(LIFTING).frequency_response(np.array([0.0]))
    with pytest.raises(InputError, match="amplitude"):
        model.linearise(LIFTING).frequency_response(amplitude=-1.0)
    with pytest.raises(InputError, match=r"displacement: .* number"):
        model.linearise(LIFTING, displacement=np.inf)
