"""The curves around a linear model against closed forms and what must hold for all values."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchid.benchmark import SHAPE, Batch, Form, Scales, Shape, structure_named
from hitchid.errors import InputError
from hitchid.record import LIFTING
from truth import STEP_S, levels

EPS = np.finfo(np.float64).eps
SCALES = Scales(*(jnp.asarray(scale) for scale in (2.0, 50.0, 50.0, 120.0, 25.0)))
NEUTRAL = {"exponent": 1.0, "saturation": 1e4}


def shape(**values):
    return Shape(jnp.array([values.get(p.name, NEUTRAL.get(p.name, 0.0)) for p in SHAPE]), SCALES)


def flow(curves, command, load=120.0):
    command = jnp.asarray(command)[None]
    return np.asarray(curves.flow(command, jnp.full(command.shape, load)))[0]


def test_neutral_curves_change_nothing():
    command = levels(np.random.default_rng(0), 200, low=-2.0, high=2.0)
    # (1 + 10⁻¹⁶)^¼ and a division by U and back.
    np.testing.assert_allclose(flow(shape(), command), command, rtol=4 * EPS)
    travel = jnp.cumsum(jnp.asarray(command))[None]
    shaped = shape().travel(travel, jnp.zeros(travel.shape), jnp.zeros(1), 1)
    np.testing.assert_allclose(
        np.asarray(shaped), travel, rtol=0, atol=200 * EPS * float(jnp.abs(travel).max())
    )


def test_flow_is_the_power_of_what_lies_beyond_the_opening_until_it_saturates():
    command = np.array([0.0, 0.3, 0.5, 1.0, 2.0])
    beyond = np.maximum(command / 2.0 - 0.2, 0.0)
    np.testing.assert_allclose(flow(shape(opening=0.2, exponent=2.0), command), 2.0 * beyond**2, rtol=8 * EPS)
    limited = beyond / (1 + (beyond / 0.3) ** 4) ** 0.25
    np.testing.assert_allclose(flow(shape(opening=0.2, saturation=0.3), command), 2.0 * limited, rtol=8 * EPS)


@settings(deadline=None, max_examples=50)
@given(
    opening=st.floats(-0.6, 0.9),
    exponent=st.floats(0.34, 3.0),
    saturation=st.floats(0.05, 1e4),
    shift=st.floats(-0.3, 0.3),
    load=st.floats(0.0, 400.0),
)
def test_flow_never_falls_with_the_command_and_a_standing_command_moves_nothing(
    opening, exponent, saturation, shift, load
):
    curves = shape(opening=opening, exponent=exponent, saturation=saturation, load_shift=shift)
    command = np.linspace(0.0, 2.5, 60)
    found = flow(curves, command, load)
    assert found[0] == 0.0
    assert np.all(np.diff(found) >= -4 * EPS * found.max())
    assert found.max() <= 2.0 * saturation * (1 + 4 * EPS)
    np.testing.assert_array_equal(flow(curves, -command, load), -found)


def test_a_gain_along_the_stroke_gives_the_travel_of_its_differential_equation():
    """dx/dt = v exp(a ξ + b ξ² − b/3), ξ = x/50 − 1: with b = 0, exp(−a ξ) falls by a v t/50 from exp(a)."""
    slope, speed = 0.8, 10.0
    errors = []
    for step_s in (0.02, 0.01):
        time_s = step_s * np.arange(round(3.0 / step_s) + 1)
        linear = jnp.asarray(speed * time_s)[None]
        found = shape(position_slope=slope).travel(linear, jnp.zeros(linear.shape), jnp.zeros(1), 1)
        place = -np.log(np.exp(slope) - slope * speed * time_s / 50.0) / slope
        errors.append(np.abs(np.asarray(found)[0] - 50.0 * (place + 1)).max())
    # One Euler step a sample: half the step, half the error.
    assert errors[1] < 0.02
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


def test_a_falling_displacement_sees_the_same_gain_where_it_is():
    linear = jnp.linspace(0.0, 20.0, 300)[None]
    none = jnp.zeros(linear.shape)
    curves = shape(position_slope=0.5, position_curve=-0.4)
    up = curves.travel(linear, none, jnp.array([10.0]), 1)
    mirrored = shape(position_slope=-0.5, position_curve=-0.4)
    down = mirrored.travel(linear, none, jnp.array([90.0]), -1)
    np.testing.assert_allclose(up, down, rtol=1e-12)


def test_the_load_scales_travel_and_shifts_the_opening():
    linear = jnp.linspace(0.0, 20.0, 300)[None]
    heavier = jnp.full(linear.shape, 145.0)
    found = shape(load_gain=0.3).travel(linear, heavier, jnp.zeros(1), 1)
    np.testing.assert_allclose(found, np.exp(0.3) * linear, rtol=1e-12)
    command = np.linspace(0.01, 2.0, 50)
    shifted = flow(shape(load_shift=0.1), command, 145.0)
    np.testing.assert_allclose(shifted, flow(shape(opening=0.1), command), rtol=1e-12, atol=1e-15)


def test_a_record_without_the_second_input_is_refused(make_record):
    record = make_record(np.linspace(80.0, 90.0, 100), np.ones(100))
    with pytest.raises(InputError, match="has no 'pressure'"):
        Batch.of([record], LIFTING, dead_zone=0.0, direction=1, load="pressure")


def test_bounds_may_be_negative_only_where_a_parameter_may():
    structure = structure_named("integrator")
    assert Form(structure, position=True, bounds={"position_slope": (-1.0, 1.0)}).bounds
    with pytest.raises(InputError, match="exponent"):
        Form(structure, curve=True, bounds={"exponent": (-1.0, 1.0)})
    with pytest.raises(InputError, match="position_slope"):
        Form(structure, bounds={"position_slope": (-1.0, 1.0)})


def test_sampling_time_does_not_enter_the_static_curve(make_record):
    record = make_record(np.linspace(80.0, 90.0, 100), np.ones(100))
    batch = Batch.of([record], LIFTING, dead_zone=0.0, direction=1)
    form = Form(structure_named("integrator"), curve=True)
    model = form.benchmark(jnp.array([3.0, 0.1, 2.0, 0.5]), SCALES)
    speed = 3.0 * flow(shape(opening=0.1, exponent=2.0, saturation=0.5), np.ones(1))[0]
    np.testing.assert_allclose(
        model.travel(batch)[0, :100], speed * STEP_S * np.arange(100), rtol=0, atol=1e-12
    )
