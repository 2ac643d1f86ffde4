"""The position controller sample by sample, and closed on its own model."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.control.axis import Axis
from hitchid.control.controller import Reference, ReferenceLimits
from hitchid.control.tuning import DECELERATION_LAGS, SPEED_SHARE
from hitchid.errors import InputError
from hitchid.structures import (
    CovariateScales,
    PhysicalModel,
    Scales,
    Scheduling,
    StaticNonlinearity,
    scheduled_quantities,
    structure_named,
)

SAMPLES = 60
STEP_S = 0.01
START = 100.0
positions = st.one_of(st.floats(60, 140), st.just(float("nan")), st.just(START))


@pytest.fixture(scope="module")
def answers(controller):
    """Return a function from targets and measurements to the controller's states and currents."""

    @jax.jit
    def run(targets, measured):
        def advance(state, row):
            state, currents = controller.step(state, *row)
            return state, (state, currents)

        return jax.lax.scan(advance, controller.initial_state(START), (targets, measured))[1]

    return lambda *rows: jax.tree.map(np.asarray, run(*(jnp.asarray(row, jnp.float64) for row in rows)))


@pytest.fixture(scope="module")
def braking(controller):
    """Return the controller with the reference of `tune`: one that stops within a lag is passed by 0.5 mm."""
    fastest = np.asarray(controller.limits_at(jnp.asarray(START)).speed) / float(controller.speed_share)
    stop_s = DECELERATION_LAGS * np.asarray(controller.lags_s)
    return replace(
        controller, deceleration=jnp.asarray(fastest / stop_s), speed_share=jnp.asarray(SPEED_SHARE)
    )


@pytest.fixture(scope="module")
def closed_on_model(braking):
    """Return a function from targets to displacement and currents, the models of the controller its plant.

    The plant is faster by a factor, drifts at a speed, and is measured with noise.
    """

    @jax.jit
    def run(targets, noise, factor, drift):
        def advance(carry, row):
            axes, displacement, state = carry
            target, error = row
            state, currents = braking.step(state, target, displacement + error)
            stepped, position = [], displacement + 0.01 * drift
            for axis, before, current in zip(braking.axes, axes, currents, strict=True):
                after = axis.step(before, current, displacement)
                position += factor * (axis.under_way(before) + after.increments[0] - axis.under_way(after))
                stepped.append(after)
            return (tuple(stepped), position, state), (displacement, currents)

        start = jnp.asarray(START)
        axes = tuple(axis.initial_state(start) for axis in braking.axes)
        return jax.lax.scan(advance, (axes, start, braking.initial_state(START)), (targets, noise))[1]

    def closed(targets, noise=0.0, factor=1.0, drift=0.0):
        rows = (jnp.asarray(row, jnp.float64) for row in (targets, np.broadcast_to(noise, targets.shape)))
        return tuple(map(np.asarray, run(*rows, factor, drift)))

    return closed


def test_a_hitch_at_its_target_has_closed_valves(controller) -> None:
    state, currents = controller.step(controller.initial_state(START), START, START)
    np.testing.assert_array_equal(currents, [0.0, 0.0])
    assert bool(state.is_holding)
    assert float(state.reference.position) == START


@given(
    levels=arrays(np.float64, 6, elements=positions), measured=arrays(np.float64, SAMPLES, elements=positions)
)
def test_currents_of_one_valve_keep_their_limits_and_rate(controller, answers, levels, measured) -> None:
    _, currents = answers(np.repeat(levels, SAMPLES // 6), measured)
    assert np.all(np.isfinite(currents))
    assert not np.any(np.all(currents > 0, axis=1))
    assert currents.min() >= 0
    assert np.all(currents <= [axis.largest_command for axis in controller.axes])
    rise = np.diff(currents, axis=0, prepend=np.zeros((1, 2)))
    assert rise.max() <= float(controller.rate) * 0.01 + 1e-12
    assert np.all(currents[np.isnan(measured)] == 0)


@pytest.mark.parametrize("target", [START + 40, START - 40])
def test_without_a_measurement_valves_close_and_the_reference_restarts(
    controller, answers, target: float
) -> None:
    measured = np.full(160, START)
    measured[30:130] = np.nan
    measured[130:] = 112.0
    states, currents = answers(np.full(160, target), measured)
    number = 0 if target > START else 1
    assert currents[29, number] > 0
    assert np.all(currents[30:130] == 0)
    speed = np.asarray(controller.limits_at(jnp.asarray(112.0)).speed)[number]
    first = states.reference.position[130]
    assert abs(first - 112.0) <= 0.01 * speed
    gains, error = controller.gains[number], abs(first - 112.0)
    assert currents[130, 1 - number] == 0
    assert abs(states.integral[130]) <= 0.01 * gains.integral * error + 1e-12


def test_a_target_that_is_lost_keeps_its_last_value(answers) -> None:
    targets = np.full(SAMPLES, START + 20)
    lost = targets.copy()
    lost[20:40] = np.nan
    measured = np.full(SAMPLES, START)
    runs = answers(targets, measured), answers(lost, measured)
    for one, other in zip(*map(jax.tree.leaves, runs), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_step_is_the_same_traced_and_mapped(controller) -> None:
    state, _ = controller.step(controller.initial_state(START), START + 20, START)
    measured = jnp.array([START + 0.1, START - 3.0, jnp.nan])
    step = partial(controller.step, state, START + 20)
    alone, traced, mapped = list(map(step, measured)), jax.jit(step), jax.vmap(step)(measured)
    for number, plain in enumerate(alone):
        rows = jax.tree.map(lambda leaf, n=number: leaf[n], mapped)
        results = (plain, traced(measured[number]), rows)
        for one, *others in zip(*map(jax.tree.leaves, results), strict=True):
            for other in others:
                np.testing.assert_allclose(other, one, rtol=0, atol=1e-12)


@pytest.mark.parametrize("step", [20.0, -20.0])
def test_a_step_on_the_model_ends_in_the_window(controller, closed_on_model, step: float) -> None:
    targets = START + np.where(np.arange(700) < 50, 0.0, step)
    displacement, currents = closed_on_model(targets)
    assert np.all(displacement[:51] == START)
    assert np.all(np.abs(displacement[-100:] - targets[-1]) < controller.hold.outer)
    assert np.all(currents[-100:] == 0)
    beyond = np.sign(step) * (displacement - targets[-1])
    assert beyond.max() < controller.hold.outer


def test_a_jump_of_the_target_has_no_speed(answers) -> None:
    targets = np.where(np.arange(SAMPLES) < 10, START, START + 20)
    states, _ = answers(targets, np.full(SAMPLES, START))
    assert np.all(states.target_speed == 0)


def test_a_controller_takes_the_speed_of_another_load() -> None:
    with jax.enable_x64(True):
        structure = structure_named("integrator-first-order").require_linear()
        quantities = scheduled_quantities(structure)
        effects = np.zeros((len(quantities), 1, 2))
        effects[quantities.index("gain"), 0, 0] = -0.2  # per standard deviation of the covariate
        covariates = CovariateScales(jnp.asarray([10.0]), jnp.asarray([2.0]))
        values = jnp.asarray([0.0, 1.0, 1e4, 0.0, 1e-15, 0.0, 0.0])
        scales = Scales(jnp.asarray(0.6), jnp.asarray(100.0), jnp.asarray(50.0), covariates)
        benchmark = PhysicalModel(
            structure,
            jnp.asarray([20.0, 0.1]),
            jnp.asarray(0.03),
            StaticNonlinearity(values, scales),
            Scheduling(("pressure",), quantities, jnp.asarray(effects)),
        )
        axis = Axis.of(benchmark, sign=1, dead_zone=0.3, step_s=0.01, largest_command=0.9)
        middle = jnp.asarray(100.0)
        mean, heavy = axis.fastest(middle), axis.at_load({"pressure": 12.0}).fastest(middle)
        again = axis.at_load({"pressure": 12.0}).at_load({"pressure": 10.0}).fastest(middle)
    np.testing.assert_allclose(heavy / mean, np.exp(-0.2), rtol=1e-12)
    np.testing.assert_allclose(again, mean, rtol=1e-12)


def test_a_load_that_the_model_does_not_know_is_refused(controller) -> None:
    with pytest.raises(InputError, match="load"):
        controller.at_load({"mass": 10.0})


@pytest.mark.parametrize("step", [30.0, -30.0])
def test_a_hitch_faster_than_its_model_takes_the_largest_current(
    controller, closed_on_model, step: float
) -> None:
    targets = START + np.where(np.arange(700) < 50, 0.0, step)
    displacement, currents = closed_on_model(targets, factor=1.4)
    number = 0 if step > 0 else 1
    left = np.sign(step) * (targets[-1] - displacement)
    # The reference brakes from v in v²/2a, and a valve that opens by the feed-forward of its lag sooner.
    speed = float(controller.axes[number].fastest(jnp.asarray(START)))
    far = np.flatnonzero((targets != START) & (left > 5 * speed * float(controller.lags_s[number])))
    largest = controller.axes[number].largest_command
    np.testing.assert_allclose(currents[far[5:], number], largest, rtol=1e-3)
    assert np.all(np.abs(displacement[-100:] - targets[-1]) < controller.hold.outer)


@pytest.mark.parametrize("drift", [-0.02, 0.02, -0.05])
def test_a_leak_costs_one_valve_action_in_ten_seconds(controller, closed_on_model, drift: float) -> None:
    noise = 0.05 * np.random.default_rng(0).standard_normal(6000)
    targets = np.full(6000, START)
    displacement, currents = closed_on_model(targets, noise, 1.0, drift)
    assert np.sum(np.diff((currents > 0).astype(int), axis=0) > 0) <= 6
    assert np.all(np.abs(displacement - START) < 5 * controller.hold.outer)


# --- the reference: it brakes at its deceleration, and never passes the target ------------------------------

LIMITS = ReferenceLimits(jnp.array([15.0, 10.0]), jnp.array([180.0, 90.0]))


@jax.jit
def followed(targets, speeds, start):
    def advance(reference, row):
        after = LIMITS.step(reference, *row, STEP_S)
        return after, after

    return jax.lax.scan(advance, Reference.at_rest(start), (targets, speeds))[1]


def reference_to(targets, speeds=0.0, start: float = 0.0) -> Reference:
    targets = jnp.asarray(targets, jnp.float64)
    speeds = jnp.broadcast_to(jnp.asarray(speeds, jnp.float64), targets.shape)
    return Reference(*map(np.asarray, followed(targets, speeds, jnp.asarray(start))))


@given(
    arrays(np.float64, 200, elements=st.floats(-200, 200)),
    arrays(np.float64, 200, elements=st.floats(-30, 30)),
    st.integers(1, 100),
)
def test_it_accelerates_no_faster_than_the_hitch_can(levels, speeds, held: int) -> None:
    reference = reference_to(np.repeat(levels, held)[:200], speeds)
    np.testing.assert_allclose(np.diff(reference.position), STEP_S * reference.speed[1:], rtol=0, atol=1e-9)
    before = np.concatenate([[0.0], reference.speed[:-1]])
    upward = np.where(reference.speed == 0, before, reference.speed) > 0
    assert np.all(np.abs(reference.acceleration) <= np.where(upward, 180.0, 90.0) * (1 + 1e-9))
    beyond = (np.minimum(before, reference.speed) >= 15.0) | (np.maximum(before, reference.speed) <= -10.0)
    assert np.all(reference.acceleration[beyond] == 0)


@given(st.floats(-50, 50), st.floats(0, 200))
def test_a_standing_target_is_reached_for_good_and_not_passed(distance: float, start: float) -> None:
    target = start + distance
    reference = reference_to(np.full(800, target), start=start)
    position = reference.position
    beyond = np.sign(distance) * (position - target)
    assert beyond.max() <= 180.0 * STEP_S**2 / 8  # the bound of the docstring
    np.testing.assert_allclose(position[-200:], target, rtol=0, atol=1e-12)
    assert np.ptp(position[-200:]) <= 1e-12
    assert not np.any(reference.speed[-50:])
    assert not np.any(reference.acceleration[-50:])


@pytest.mark.parametrize("distance", [60.0, 20.0, 5.0, 0.5, -60.0, -20.0, -5.0, -0.5])
def test_the_way_takes_the_time_of_its_deceleration(distance: float) -> None:
    """From a speed v it takes v/a = √(2 e/a) to stop after e; a sample at either end may be a part of one."""
    braking_s = np.sqrt(2 * abs(distance) / (180.0 if distance > 0 else 90.0))
    position = reference_to(np.full(900, distance)).position
    arrived = STEP_S * (1 + np.flatnonzero(np.abs(position - distance) < 1e-6)[0])
    assert arrived == pytest.approx(braking_s, abs=2 * STEP_S)


@pytest.mark.parametrize("speed", [12.0, 3.0, -3.0, -8.0])
def test_a_ramp_is_followed_one_sample_ahead_of_its_target(speed: float) -> None:
    target = 5.0 + speed * STEP_S * np.arange(1500)
    reference = reference_to(target, speed)
    np.testing.assert_allclose(reference.position[-300:], target[-300:] + speed * STEP_S, rtol=0, atol=1e-9)
    np.testing.assert_allclose(reference.speed[-300:], speed, atol=1e-7)
