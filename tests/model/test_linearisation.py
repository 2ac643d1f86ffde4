"""The linear model about an operating point, as it is and as scipy and python-control have it."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import handmade
from hitchid.errors import InputError
from hitchid.handover.linear import describing_function
from hitchid.handover.responses import frequency_response
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Estimates, Uncertainty
from hitchid.structures import PhysicalModel, structure_named
from report import reported

DEAD_TIME_S = 0.0317
SPREAD = 0.1  # standard error of the logarithm of the gain
DRAWS = 2000
FREQUENCY_HZ = np.geomspace(0.05, 10.0, 25)


def uncertain(model, spread=SPREAD):
    """Return a model whose gain in each direction has a standard error, unless its spread is None."""
    by_direction = {}
    for direction in model.channels:
        gain = handmade.GAINS[direction]
        estimate = reported.estimate(value=gain, error=spread and spread * gain, interval=(None, None))
        by_direction[direction] = Uncertainty(Estimates((estimate,), (), ((1.0,),), 5, 5))
    return replace(model, uncertainty=by_direction)


def response(computed):
    """Return the complex frequency response."""
    return computed.magnitude.value * np.exp(1j * computed.phase_rad.value)


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
    computed = linear.frequency_response(FREQUENCY_HZ)
    # Which is compared with scipy's in `test_responses.py`.
    expected = frequency_response(model.channels[direction], FREQUENCY_HZ, None, None)
    np.testing.assert_allclose(response(computed), response(expected), rtol=1e-9)
    assert linear.gain.value == pytest.approx(linear.sign * handmade.GAINS[direction], rel=1e-12)
    assert linear.drawn is None
    assert linear.models() == ()
    # Lowering falls.
    assert np.sign(model.to_scipy(direction, 0.01).C[0, 0]) == linear.sign == handmade.DIRECTIONS[direction]


def test_the_continuous_model_has_the_approximated_dead_time():
    model = handmade.hitch("integrator-second-order", dead_time_s=DEAD_TIME_S)
    linear = model.linearise(LIFTING)
    slow = FREQUENCY_HZ[2 * np.pi * FREQUENCY_HZ * DEAD_TIME_S < 1]
    exact = response(linear.frequency_response(slow))
    # The approximant of order n departs in phase by 2 (n!)² x^(2n+1)/((2n)! (2n+1)!): 8e-8 rad at x = 1.
    np.testing.assert_allclose(of_matrices(linear.to_scipy(), 2j * np.pi * slow), exact, rtol=1e-7)


def test_drawn_models_have_the_spread_of_the_estimates():
    model = uncertain(handmade.hitch("integrator-first-order", dead_time_s=DEAD_TIME_S))
    linear = model.linearise(LOWERING, draws=DRAWS)
    logarithms = np.log(np.abs(linear.drawn.gain * linear.drawn.b[:, -1]))
    # Standard error of a standard deviation over the draws; five of them.
    assert logarithms.std() / SPREAD == pytest.approx(1, abs=5 / np.sqrt(2 * DRAWS))
    gain = linear.gain
    assert gain.lower < gain.value < gain.upper < 0
    # Quantiles of a log-normal gain, with their standard error √(q (1 − q)/n)/φ(z) = 0.06 deviations; five.
    for computed, quantile in ((gain.upper, -1.96), (gain.lower, 1.96)):
        assert np.log(computed / gain.value) / SPREAD == pytest.approx(quantile, abs=0.3)
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


def test_the_gain_is_the_slope_of_the_steady_speed():
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


def test_a_sine_within_the_play_moves_nothing():
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


# --- as scipy and python-control have it: steps of 60 s ----------------------------------------------------

STRUCTURES = ("integrator", "first-order-lag", "integrator-first-order", "integrator-second-order")
SLOW = 1e-4  # factor on the gain, such that 60 s of motion are a small part of the stroke
LENGTH_S = 60.0
at_step_times = pytest.mark.parametrize("step_s", [0.001, 0.01])


def simulated(model, direction, command):
    """Return the physical model's displacement from 100 mm at mean load."""
    load = 120.0 if model.channels[direction].benchmark.covariates else None
    commands = np.zeros((command.size, 2))
    commands[:, (LIFTING, LOWERING).index(direction)] = command
    run = model.simulate(commands, step_s=model.step_s, initial=100.0, load=load, compensated=False)
    return run.displacement


def steps(model, low, high):
    """Return a command of one level, then of another, after a sample of rest."""
    samples = round(LENGTH_S / model.step_s)
    return np.concatenate([[0.0], np.full(samples // 6 - 1, low), np.full(samples - samples // 6, high)])


def relative_error(system, command, expected):
    """Return the largest difference of scipy's response from what is expected, over the largest of these."""
    _, response, _ = signal.dlsim((system.A, system.B, system.C, system.D, system.dt), command)
    return float(np.max(np.abs(response.ravel() - expected)) / np.max(np.abs(expected)))


@pytest.mark.long
@at_step_times
@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("direction", [LIFTING, LOWERING])
def test_a_step_of_60_s_agrees_with_the_simulation(structure, direction, step_s):
    model = replace(handmade.hitch(structure, dead_time_s=0.0374), step_s=step_s)
    dead_zone = model.channels[direction].dead_zone
    command = steps(model, dead_zone + 0.1, dead_zone + 0.2)
    travel = simulated(model, direction, command) - 100.0
    system = model.to_scipy(direction, step_s)
    assert relative_error(system, np.maximum(command - dead_zone, 0.0), travel) <= 1e-6


@pytest.mark.long
@at_step_times
def test_a_small_step_agrees_to_the_order_of_its_size(step_s):
    curved = handmade.channel(LIFTING, "integrator-second-order", dead_time_s=0.0374, shape=True)
    slow = handmade.hitch_of(curved).with_parameters(lifting={"gain": SLOW * handmade.GAINS[LIFTING]})
    model, command = replace(slow, step_s=step_s), curved.dead_zone + 0.3
    system = model.to_control(LIFTING, step_s, command=command, displacement=100.0, load=120.0)
    errors, sizes = [], np.array([2e-3, 1e-3, 5e-4])
    for size in sizes:
        low, high = steps(model, command, command), steps(model, command, command + size)
        travel = simulated(model, LIFTING, high) - simulated(model, LIFTING, low)
        errors.append(relative_error(system, high - low, travel))
    # The operating point in shares of U = 1.2 A beyond the opening d = 0.1, at mean load (120 bar), with
    # exponent n = 1.5 and saturation σ = 2: v = a^n, w = v (1 + (v/σ)⁴)^(-1/4).
    above_opening = 0.3 / 1.2 - 0.1
    # w''/(2 w') = (n − 1)/(2 a); saturation and higher orders change it by less than a tenth.
    curvature = 0.5 / (2 * above_opening) * sizes / 1.2
    # The nominal motion of 60 s, and the gain's change along it: |d ln g/dξ| ≤ 0.2 + 2·0.1·|ξ| < 0.21 at
    # mid stroke, ξ within 60 s K w g/span with g < 1.1.
    travel = 60 * SLOW * 30.0 * 1.2 * above_opening**1.5 * 1.1
    drift = 0.21 * travel / 60.0
    assert np.all(np.array(errors) <= 1.1 * curvature + drift)
    # Halved step, halved error beyond that of the stroke, which is the same.
    assert np.all(np.abs(np.diff(errors)) >= 0.5 * np.abs(np.diff(curvature)))


def test_the_continuous_model_is_the_limit_of_the_discrete_one():
    model = handmade.hitch_of(handmade.channel(LIFTING, "integrator-first-order", shape=True))
    point = {"command": 0.8, "displacement": 90.0, "load": 130.0}
    continuous = model.to_scipy(step_s=None, **point)
    step_s = 1e-5
    fine = model.to_scipy(step_s=step_s, **point)
    omega = np.array([0.5, 5.0, 50.0])
    exact, computed = of_matrices(continuous, 1j * omega), of_matrices(fine, np.exp(1j * omega * step_s))
    # A held command and a held flow are late by half a sample each: ω h/2 of phase each.
    assert np.all(np.abs(computed / exact - 1) <= 1.1 * omega * step_s)


def test_nonlinear_structures_and_closed_valves_are_refused():
    model = handmade.hitch(shape=True)
    with pytest.raises(InputError, match=r"beyond the dead zone, where the valve opens; got 0\.05"):
        model.to_control(LIFTING, 0.01, command=handmade.DEAD_ZONES[LIFTING] + 0.05)
    with pytest.raises(InputError, match=r"beyond the dead zone of 0.35, got 0.3"):
        model.to_control(LIFTING, 0.01, command=0.3)
    with pytest.raises(InputError, match="direction: expected one of lifting, lowering"):
        model.to_control(step_s=0.01)
    structure = structure_named("cascaded-tanks")
    benchmark = PhysicalModel(structure, jnp.ones(len(structure.parameters)), jnp.zeros(()))
    tanks = handmade.hitch_of(replace(handmade.channel(LIFTING), benchmark=benchmark))
    with pytest.raises(InputError, match=r"nonlinear structure 'cascaded-tanks'.*use `simulate`"):
        tanks.to_control(step_s=0.01)
    for call in (lambda: tanks.speed(1.0), lambda: tanks.inverse_table()):
        with pytest.raises(InputError, match=r"nonlinear structure 'cascaded-tanks'.*constant command"):
            call()


def test_the_default_operating_point_is_open_for_any_opening():
    channel = handmade.channel(LIFTING, shape=True)
    curves = channel.benchmark.nonlinearity
    late = replace(curves, values=curves.values.at[0].set(0.9))
    model = handmade.hitch_of(replace(channel, benchmark=replace(channel.benchmark, nonlinearity=late)))
    command = handmade.DEAD_ZONES[LIFTING] + 1.2 * (0.9 + 1) / 2
    at = {"command": command, "displacement": 100.0, "load": 120.0}
    np.testing.assert_allclose(model.to_scipy(step_s=0.01).C, model.to_scipy(step_s=0.01, **at).C, rtol=1e-14)
