"""A natural frequency that varies along the stroke: equations of motion, and what holds for all values."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.estimation import Objective, refine_subset
from hitchid.logs.record import LIFTING, Record
from hitchid.structures import (
    Batch,
    DiscretePhysicalModel,
    ModelSpec,
    Scales,
    discretise,
    linearise,
    structure_named,
)
from hitchid.structures.discretisation import STROKE_NODES, STROKE_RANGE, discretise_along_stroke

GAIN, OMEGA, DAMPING, FRICTION_TRAVEL = 40.0, 8.0, 0.2, 0.5  # mm/(A s), rad/s, 1, mm
STRUCTURE = structure_named("integrator-second-order-stroke")
FRICTION = structure_named("integrator-second-order-friction")
CENTRE, SPAN = 40.0, 40.0  # mm
SCALES = Scales(*(jnp.asarray(value) for value in (1.0, CENTRE, SPAN)))
STEP_S, SAMPLES = 0.01, 300


def model(slope, structure=STRUCTURE):
    values = [GAIN, OMEGA, DAMPING, FRICTION_TRAVEL, -1.0, *([slope] if structure is STRUCTURE else [])]
    spec = ModelSpec(structure, stroke_gain_linear=True)
    return spec.physical_model(jnp.array([*values, 0.0]), SCALES)


def batch_of(commands, displacements=None):
    units, records = {"lifting_command": "A", "displacement": "mm"}, []
    for number, command in enumerate(commands):
        displacement = np.zeros(len(command)) if displacements is None else displacements[number]
        signals = {"lifting_command": command, "displacement": displacement}
        records.append(Record(f"test {number}", STEP_S, signals, units))
    return Batch.of(records, LIFTING, dead_zone=0.0, sign=1, initial=[0.0] * len(records))


def steps():
    time_s = STEP_S * np.arange(SAMPLES)
    return np.select([time_s < 0.2, time_s < 1.2, time_s < 1.6, time_s < 2.4], [0.0, 1.0, 0.0, 0.7], 0.0)


def travel(physical_model, command):
    return np.asarray(physical_model.travel(batch_of([command])))[0, : len(command)]


def by_small_steps(slope, command, substeps=200):
    """Return travel by explicit Euler steps of v̇ = ω q − δ ω² φ, q̇ = ω (K u − v) − 2 ξ v̇, ω = ω(x)."""
    h, position, speed, travels = STEP_S / substeps, 0.0, 0.0, []
    pressure = -FRICTION_TRAVEL * OMEGA * np.exp(-slope)
    for u in command:
        travels.append(position)
        for _ in range(substeps):
            omega = OMEGA * np.exp(slope * (position - CENTRE) / SPAN)
            friction = FRICTION_TRAVEL * omega**2
            next_speed = speed + h * omega * pressure
            held = abs(next_speed) <= h * friction
            next_speed = 0.0 if held else next_speed - h * friction * np.sign(next_speed)
            pressure += h * omega * (GAIN * u - speed) - 2 * DAMPING * (next_speed - speed)
            position, speed = position + h * next_speed, next_speed
    return np.array(travels)


@pytest.mark.parametrize("slope", [-0.4, 0.4])
def test_its_travel_is_that_of_its_equations_of_motion(slope):
    command = steps()
    computed, expected = travel(model(slope), command), by_small_steps(slope, command)
    # Friction and frequency are constant over a sample: a reversal of friction puts the speed off by that of
    # one sample, and the frequency is late by half the travel of one.
    highest = OMEGA * np.exp(abs(slope) * np.abs(expected - CENTRE).max() / SPAN)
    reversal = FRICTION_TRAVEL * highest * STEP_S
    late = abs(slope) / SPAN * 0.5 * np.abs(np.diff(expected)).max()
    assert np.abs(computed - expected).max() < reversal + late * np.ptp(expected)
    constant = travel(model(0.0), command)
    assert np.abs(constant - expected).max() > 4 * np.abs(computed - expected).max()


def test_without_slope_it_is_the_structure_with_dry_friction():
    plain = model(0.0, FRICTION)
    # Interpolation between equal models rounds in the last digit, which 300 samples of travel add up.
    np.testing.assert_allclose(
        travel(model(0.0), steps()), travel(plain, steps()), rtol=0, atol=SAMPLES * 1e-13 * GAIN
    )


@pytest.mark.parametrize("slope", [-0.7, 0.5])
@pytest.mark.long
def test_between_nodes_it_is_the_model_of_the_place(slope):
    """A straight line between nodes d apart is off by at most d²/8 of the second derivative."""
    values = model(slope).values
    along = discretise_along_stroke(STRUCTURE, values, 0.013, STEP_S)
    width = 2 * STROKE_RANGE / (STROKE_NODES - 1)

    def entries(position):
        exact = discretise(STRUCTURE, STRUCTURE.values_at(values, position), 0.013, STEP_S)
        return jnp.concatenate([exact.transition.ravel(), exact.gamma0, exact.gamma1, exact.friction.gains])

    places = jnp.linspace(-STROKE_RANGE, STROKE_RANGE, 301)
    second = np.abs(jax.vmap(jax.jacfwd(jax.jacfwd(entries)))(places)).max(axis=0)
    for place in (-1.23, 0.02, 0.777):
        computed = along.at(jnp.asarray(place))
        at_place = jnp.concatenate(
            [computed.transition.ravel(), computed.gamma0, computed.gamma1, computed.friction.gains]
        )
        bound = width**2 / 8 * second
        assert np.all(np.abs(at_place - entries(jnp.asarray(place))) <= 1.01 * bound + 1e-12)


def test_beyond_the_range_the_dynamics_stay():
    along = discretise_along_stroke(STRUCTURE, model(0.5).values, 0.0, STEP_S)
    for far, end in ((5.0, STROKE_RANGE), (-5.0, -STROKE_RANGE)):
        np.testing.assert_array_equal(
            along.at(jnp.asarray(far)).transition, along.at(jnp.asarray(end)).transition
        )


@given(slope=st.floats(-1.0, 1.0), omega=st.floats(0.5, 200.0), start=st.floats(-100.0, 200.0))
def test_travel_and_gradients_are_finite(slope, omega, start):
    batch = batch_of([steps()])
    batch = replace(batch, initial=jnp.array([start]))

    def response(values):
        return ModelSpec(STRUCTURE).physical_model(values, SCALES).travel(batch)

    values = jnp.array([GAIN, omega, DAMPING, FRICTION_TRAVEL, 0.3, slope])
    assert np.isfinite(response(values)).all()
    assert np.isfinite(jax.jacfwd(response)(values)).all()


@pytest.mark.parametrize("structure", [STRUCTURE, FRICTION], ids=lambda structure: structure.name)
def test_one_sample_at_a_time_it_is_the_whole_travel(structure):
    physical_model, command = model(0.4, structure), steps()
    discrete = DiscretePhysicalModel.of(
        physical_model, dead_zone=0.0, min_command=1e-6, sign=1, step_s=STEP_S
    )
    zero = jnp.zeros(())
    valve, plant, position, computed = discrete.closed_valve(), discrete.init_state(zero, zero), zero, []
    for u in command:
        computed.append(float(position))
        valve = discrete.step_valve(valve, jnp.asarray(u))
        plant, increment = discrete.advance(plant, valve, position)
        position = position + increment
    np.testing.assert_allclose(computed, travel(physical_model, command), rtol=0, atol=1e-9)


@pytest.mark.parametrize("displacement", [10.0, 40.0, 75.0])
def test_a_linear_model_has_the_frequency_of_its_displacement(displacement):
    linear = linearise(model(0.4), displacement=displacement, command=0.5)
    computed = np.sort(np.abs(np.linalg.eigvals(linear.a)))[1:]
    np.testing.assert_allclose(computed, OMEGA * np.exp(0.4 * (displacement - CENTRE) / SPAN), rtol=1e-9)


def test_its_parameters_are_identified_from_its_own_travel():
    rng = np.random.default_rng(0)
    spec = ModelSpec(STRUCTURE)
    levels = rng.uniform(0.2, 1.0, (4, 10)) * rng.integers(0, 2, (4, 10))
    commands = np.repeat(levels, 40, axis=1) * (np.arange(400) >= 20)
    truth = jnp.array([GAIN, OMEGA, DAMPING, FRICTION_TRAVEL, -0.6, 0.3])
    simulated = Objective.of(batch_of(commands, [np.linspace(0, 80, 400)] * 4), spec)
    displacements = np.asarray(spec.physical_model(truth, simulated.scales).travel(batch_of(commands)))
    objective = Objective.of(batch_of(commands, list(displacements[:, :400])), spec)
    start = objective.position(np.array([35.0, 6.0, 0.4, 0.2, 0.0, 0.0]))
    fit = refine_subset(objective, range(6), [start], 120, 1e-14)
    computed = objective.values(fit.position)
    np.testing.assert_allclose(computed[0], GAIN, rtol=1e-3)
    # ξ of the fit is in half ranges of its own tests: the slope per millimetre is what is determined.
    slope_per_mm = computed[5] / float(objective.scales.span)
    np.testing.assert_allclose(slope_per_mm, 0.3 / float(simulated.scales.span), rtol=2e-2)
