"""The curves around a linear model against closed forms and what must hold for all values."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, Record
from hitchid.structures import (
    NONLINEARITY_PARAMETERS,
    Batch,
    ModelSpec,
    PhysicalModel,
    Scales,
    StaticNonlinearity,
    structure_named,
)
from hitchid.structures.nonlinearity import MAX_EXTRAPOLATION, NEUTRAL, QUADRATIC_RANGE
from truth import STEP_S, levels

EPS = np.finfo(np.float64).eps
SCALES = Scales(*(jnp.asarray(scale) for scale in (2.0, 50.0, 50.0)))
DEAD_ZONE = 0.4


def shape(**values):
    return StaticNonlinearity(
        jnp.array([values.get(p.name, NEUTRAL.get(p.name, 0.0)) for p in NONLINEARITY_PARAMETERS]), SCALES
    )


compiled_flow = eqx.filter_jit(StaticNonlinearity.flow)
compiled_effective = eqx.filter_jit(StaticNonlinearity.effective)


def flow(curves, command):
    return np.asarray(compiled_flow(curves, jnp.asarray(command)[None]))[0]


def effective(curves, command, dead_zone=DEAD_ZONE):
    zones = jnp.array([dead_zone])
    return np.asarray(compiled_effective(curves, jnp.asarray(command)[None], zones, STEP_S))[0]


def travelled(curves, speed, start, *, sign=1, step_s=STEP_S):
    """Return the travel of an integrator of constant speed behind a valve without dead zone."""
    signals = {"displacement": np.full(speed.size, start), "lifting_command": speed}
    record = Record("a", step_s, signals, {"displacement": "mm", "lifting_command": "A"})
    integrator = PhysicalModel(
        structure_named("integrator"), jnp.ones(1), jnp.asarray(0.0), nonlinearity=curves
    )
    batch = Batch.of([record], LIFTING, dead_zone=0.0, sign=sign)
    return np.asarray(integrator.travel(batch))[0, : speed.size]


def test_neutral_curves_change_nothing():
    command = levels(np.random.default_rng(0), 200, low=-2.0, high=2.0)
    # (1 + 10⁻¹⁶)^¼ and a division by U and back.
    np.testing.assert_allclose(flow(shape(), command), command, rtol=4 * EPS)
    np.testing.assert_array_equal(gain(shape(), np.linspace(-3.0, 3.0, 50)), 1.0)


def played(spool, width):
    """Return the play operator of half-width `width` by its definition, from zero, shape [N]."""
    held, positions = 0.0, []
    for s in spool:
        held = min(max(held, s - width), s + width)
        positions.append(held)
    return np.array(positions)


@given(seed=st.integers(0, 2**16), hysteresis=st.floats(0.0, 1.0), dead_zone=st.floats(0.05, 1.0))
def test_hysteresis_is_the_play_operator(seed, hysteresis, dead_zone):
    command = np.random.default_rng(seed).uniform(-2.0, 2.0, 120)
    half = 0.5 * hysteresis * dead_zone
    held = played(command, half)
    expected = np.sign(held) * np.maximum(np.abs(held) - dead_zone + half, 0.0)
    # The neutral lag: τ/h of a step of 4 at most, which play may keep.
    bound = 4.0 * NEUTRAL["spool_lag"] / STEP_S + 8 * EPS
    np.testing.assert_allclose(
        effective(shape(hysteresis=hysteresis), command, dead_zone), expected, rtol=0, atol=bound
    )


@pytest.mark.parametrize("lag", [1e-3, 0.02, 0.5])
def test_the_spool_answers_a_step_as_a_lag(lag):
    """s(t) = 1 − exp(−t/τ); its mean from k h to (k + 1) h is 1 − τ/h (exp(−k h/τ) − exp(−(k + 1) h/τ))."""
    edge = np.exp(-STEP_S * np.arange(301) / lag)
    expected = 1.5 * (1 - lag / STEP_S * (edge[:-1] - edge[1:]))
    computed = effective(shape(spool_lag=lag), np.full(300, 1.5), dead_zone=0.0)
    # Differences of exponentials, τ/h times, and 300 products.
    np.testing.assert_allclose(computed, expected, rtol=0, atol=300 * EPS * 1.5 * max(1.0, lag / STEP_S))
    beyond = effective(shape(spool_lag=lag), np.full(300, 1.5))
    np.testing.assert_allclose(beyond, np.maximum(expected - DEAD_ZONE, 0.0), rtol=0, atol=1e-13)


@given(
    seed=st.integers(0, 2**16),
    hysteresis=st.floats(0.0, 1.0),
    lag=st.sampled_from([NEUTRAL["spool_lag"], 1e-3, 0.03]),
    opening=st.floats(-0.6, 0.9),
    dead_zone=st.floats(0.0, 1.0),
)
def test_a_command_of_zero_lets_nothing_flow_for_any_hysteresis(seed, hysteresis, lag, opening, dead_zone):
    curves = shape(hysteresis=hysteresis, spool_lag=lag, opening=opening)
    never = effective(curves, np.zeros(50), dead_zone)
    assert not np.any(flow(curves, never))
    moved = np.random.default_rng(seed).uniform(-2.0, 2.0, 60)
    after = effective(curves, np.concatenate([moved, np.zeros(300)]), dead_zone)[60:]
    # The lag runs out; once less of the spool is left than the width leaves of the dead zone, or than a
    # thousandth of the largest command, 2.0, all is shut, however far below the dead zone the valve opens.
    room = max(dead_zone * (1 - hysteresis), 1e-3 * 2.0)
    left = 2.0 * np.exp(-STEP_S * np.arange(300) / lag) * max(1.0, lag / STEP_S)
    assert not np.any(flow(curves, after)[left < room - 4 * EPS])
    assert np.count_nonzero(left < room - 4 * EPS) > 250


def test_flow_is_a_power_until_it_saturates():
    command = np.array([0.0, 0.3, 0.5, 1.0, 2.0])
    beyond = np.maximum(command / 2.0 - 0.2, 0.0)
    # At the largest command, 2 A, flow is the command whatever the curve.
    power = 2.0 * (beyond / 0.8) ** 2
    np.testing.assert_allclose(flow(shape(opening=0.2, exponent=2.0), command), power, rtol=16 * EPS)
    limited = beyond / (1 + (beyond / 0.3) ** 4) ** 0.25
    saturating = 2.0 * limited / limited[-1]
    np.testing.assert_allclose(flow(shape(opening=0.2, saturation=0.3), command), saturating, rtol=16 * EPS)


@given(opening=st.floats(-0.6, 0.9), exponent=st.floats(0.34, 3.0), saturation=st.floats(0.05, 1e4))
def test_flow_never_falls_with_the_command(opening, exponent, saturation):
    curves = shape(opening=opening, exponent=exponent, saturation=saturation)
    command = np.linspace(0.0, 2.5, 60)
    computed = flow(curves, command)
    assert computed[0] == 0.0
    assert np.all(np.diff(computed) >= -4 * EPS * computed.max())
    reach = float(curves.largest_share)
    assert computed.max() <= 2.0 * saturation / reach * (1 + 8 * EPS)
    assert flow(curves, np.array([2.0]))[0] == pytest.approx(2.0, rel=8 * EPS)
    np.testing.assert_array_equal(flow(curves, -command), -computed)


def test_a_gain_along_the_stroke_solves_its_equation():
    """dx/dt = v exp(a ξ + b ξ² − b/3), ξ = x/50 − 1: with b = 0, exp(−a ξ) falls by a v t/50 from exp(a)."""
    slope, speed = 0.8, 10.0
    errors = []
    for step_s in (0.02, 0.01):
        time_s = step_s * np.arange(round(3.0 / step_s) + 1)
        curves = shape(position_slope=slope)
        computed = travelled(curves, np.full(time_s.size, speed), 0.0, step_s=step_s)
        place = -np.log(np.exp(slope) - slope * speed * time_s / 50.0) / slope
        errors.append(np.abs(computed - 50.0 * (place + 1)).max())
    # One Euler step a sample: half the step, half the error.
    assert errors[1] < 0.02
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


def test_a_falling_displacement_sees_the_same_gain_where_it_is():
    speed = np.full(300, 10.0)
    up = travelled(shape(position_slope=0.5, position_curve=-0.4), speed, 10.0)
    down = travelled(shape(position_slope=-0.5, position_curve=-0.4), speed, 90.0, sign=-1)
    assert up[-1] > 20.0
    np.testing.assert_allclose(up, down, rtol=1e-12)


compiled_gain = eqx.filter_jit(StaticNonlinearity.gain)


def gain(curves, place):
    """Return the gain at places in half ranges from the centre, 50 mm each, shape [N]."""
    displacement = 50.0 + 50.0 * np.asarray(place)
    return np.asarray(compiled_gain(curves, jnp.asarray(displacement)))


slopes = st.floats(-2.0, 2.0)


@given(slope=slopes, curve=slopes, place=st.floats(-QUADRATIC_RANGE, QUADRATIC_RANGE))
def test_within_reach_the_gain_is_its_formula(slope, curve, place):
    computed = gain(shape(position_slope=slope, position_curve=curve), [place])
    # Exponents up to 7 of places that round in 50 ± 75 mm.
    expected = np.exp(slope * place + curve * (place**2 - 1 / 3))
    np.testing.assert_allclose(computed, expected, rtol=50 * EPS)


@given(slope=slopes, curve=slopes, beyond=st.floats(0.0, 1e4), side=st.sampled_from([-1.0, 1.0]))
def test_beyond_reach_the_gain_changes_by_two_at_most(slope, curve, beyond, side):
    curves = shape(position_slope=slope, position_curve=curve)
    edge, far = gain(curves, [side * QUADRATIC_RANGE, side * (QUADRATIC_RANGE + beyond)])
    went_on = float(np.clip(side * slope * beyond, -MAX_EXTRAPOLATION, MAX_EXTRAPOLATION))
    # A place of up to 1e4 half ranges times a slope of two, of which up to 0.7 counts.
    assert far / edge == pytest.approx(np.exp(went_on), rel=50 * EPS + 4 * EPS * abs(slope) * QUADRATIC_RANGE)
    assert abs(MAX_EXTRAPOLATION - np.log(2.0)) < 0.01


def test_bounds_may_be_negative_only_where_a_parameter_may():
    structure = structure_named("integrator")
    assert ModelSpec(structure, stroke_gain_quadratic=True, bounds={"position_slope": (-1.0, 1.0)}).bounds
    with pytest.raises(InputError, match="exponent"):
        ModelSpec(structure, valve_curve=True, bounds={"exponent": (-1.0, 1.0)})
    with pytest.raises(InputError, match="position_slope"):
        ModelSpec(structure, bounds={"position_slope": (-1.0, 1.0)})


def test_hysteresis_has_a_derivative_where_it_is_zero():
    # A ramp up, a level, a ramp down: what lies beyond the dead zone is linear in a small hysteresis.
    command = jnp.concatenate([jnp.linspace(0.0, 2.0, 50), jnp.full(20, 2.0), jnp.linspace(2.0, 0.0, 50)])

    def effective(hysteresis):
        number = [parameter.name for parameter in NONLINEARITY_PARAMETERS].index("hysteresis")
        curves = StaticNonlinearity(shape().values.at[number].set(hysteresis), SCALES)
        return curves.effective(command[None], jnp.array([DEAD_ZONE]), STEP_S)[0]

    at_zero, derivative = jax.jvp(effective, (jnp.zeros(()),), (jnp.ones(()),))
    small = 1e-6
    quotient = (effective(jnp.asarray(small)) - at_zero) / small

    assert float(jnp.max(jnp.abs(derivative))) > 0.1 * DEAD_ZONE
    np.testing.assert_allclose(derivative, quotient, atol=10 * EPS * float(command.max()) / small)
