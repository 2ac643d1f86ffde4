"""A second-order lag with dry friction: its equations of motion, and what holds for all parameters."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.structures import PhysicalModel, structure_named

GAIN, OMEGA, DAMPING, TRAVEL = 40.0, 8.0, 0.2, 0.5  # mm/(A s), rad/s, 1, mm
STRUCTURE = structure_named("integrator-second-order-friction")
STEP_S, SAMPLES = 0.01, 400


def model(travel=TRAVEL, at_rest=-1.0, *, gain=GAIN, omega=OMEGA, damping=DAMPING):
    return PhysicalModel(STRUCTURE, jnp.array([gain, omega, damping, travel, at_rest]), jnp.asarray(0.0))


def stepped(step_s=STEP_S):
    """Return a command of steps with pauses in which the piston comes to rest, shape [1, N]."""
    time_s = step_s * np.arange(round(SAMPLES * STEP_S / step_s))
    command = np.select([time_s < 0.2, time_s < 1.0, time_s < 2.5, time_s < 3.2], [0.0, 0.5, 0.0, 0.3], 0.0)
    return jnp.asarray(command[None])


def by_small_steps(command, *, at_rest, substeps=200):
    """Return travel by explicit Euler steps, friction holding where it can."""
    h, friction = STEP_S / substeps, TRAVEL * OMEGA**2
    travel, speed, pressure, travels = 0.0, 0.0, friction * at_rest, []
    for u in np.asarray(command)[0]:
        travels.append(travel)
        for _ in range(substeps):
            next_speed = speed + h * pressure
            held = abs(next_speed) <= h * friction
            next_speed = 0.0 if held else next_speed - h * friction * np.sign(next_speed)
            acceleration = (next_speed - speed) / h
            pressure += h * (OMEGA**2 * (GAIN * u - speed) - 2 * DAMPING * OMEGA * acceleration)
            travel, speed = travel + h * next_speed, next_speed
    return np.array(travels)


@pytest.mark.parametrize("at_rest", [-1.0, 0.0, 1.0])
def test_its_response_is_that_of_its_equations_of_motion(at_rest):
    command = stepped()
    computed = np.asarray(model(at_rest=at_rest).response(command, STEP_S))[0]
    expected = by_small_steps(command, at_rest=at_rest)
    # Friction is constant over a sample: where it reverses, its effect on the speed is off by one sample.
    reversal = TRAVEL * OMEGA**2 * STEP_S
    assert np.abs(computed - expected).max() < reversal / OMEGA
    assert np.ptp(expected) > 20.0


def test_the_error_of_the_time_stepping_falls_with_the_step():
    fine = np.asarray(model().response(stepped(STEP_S / 16), STEP_S / 16))[0]
    errors = []
    for divisor in (1, 2, 4):
        step_s = STEP_S / divisor
        computed = np.asarray(model().response(stepped(step_s), step_s))[0]
        errors.append(np.abs(computed - fine[:: 16 // divisor]).max())
    assert errors[2] < 0.6 * errors[0]
    assert errors[0] < TRAVEL * OMEGA**2 * STEP_S / OMEGA


def test_friction_at_rest_delays_the_first_motion():
    """The pressure changes at the rate ωh² K u and by 2 δ ωh² before the load moves: 2 δ/(K u) later."""
    first = [np.asarray(model(at_rest=share).response(stepped(), STEP_S))[0] for share in (-1.0, 1.0)]
    starts = [int(np.argmax(np.abs(travel) > 0.01)) for travel in first]
    assert starts[0] - starts[1] == pytest.approx(2 * TRAVEL / (GAIN * 0.5) / STEP_S, abs=1)


def test_with_little_friction_it_is_the_linear_lag():
    linear = PhysicalModel(
        structure_named("integrator-second-order"), jnp.array([GAIN, OMEGA, DAMPING]), jnp.asarray(0.0)
    )
    travel = 1e-9
    computed, expected = (
        np.asarray(benchmark.response(stepped(), STEP_S)) for benchmark in (model(travel), linear)
    )
    # Friction holds the travel back by no more than a few times the travel that it compresses the oil by.
    np.testing.assert_allclose(computed, expected, rtol=0, atol=SAMPLES * travel)


@given(
    travel=st.floats(1e-4, 5.0),
    at_rest=st.floats(-1.0, 1.0),
    omega=st.floats(0.5, 500.0),
    damping=st.floats(0.05, 5.0),
    level=st.floats(0.0, 1.0),
)
def test_it_comes_to_rest_and_its_gradients_are_finite(travel, at_rest, omega, damping, level):
    settling = 12 / (omega * min(damping, 1 / (4 * damping)))
    step_s = max(STEP_S, (1.0 + settling) / SAMPLES)
    command = np.where(np.arange(SAMPLES) * step_s < 0.5, level, 0.0)[None]

    def response(values):
        return PhysicalModel(STRUCTURE, values, jnp.asarray(0.0)).response(jnp.asarray(command), step_s)

    values = jnp.array([GAIN, omega, damping, travel, at_rest])
    computed = np.asarray(response(values))[0]
    assert np.isfinite(computed).all()
    assert np.ptp(computed[-3:]) <= 1e-3 * max(np.ptp(computed), travel)
    columns = jax.jacfwd(response)(values)
    assert np.isfinite(columns).all()
