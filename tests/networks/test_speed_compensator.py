"""The compensator for free run: what it may do, what it never does, and its equations in a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handmade import envelope, speed_compensator
from hitchid.networks.speed_compensator import SPEED_AUTHORITY, simulate_compensated

EPS = np.finfo(np.float64).eps
SAMPLES, TESTS, STEP_S = 200, 3, 0.01
# Exact in binary, so that sums of differences are too.
FINE = 2.0**-10


def made_up(seed=0, *, samples=SAMPLES):
    """Return travel, growing in each sample, and command, shape [T, N], initial, shape [T], and load."""
    rng = np.random.default_rng(seed)
    steps = FINE * rng.integers(1, 400, (TESTS, samples))
    travel = np.cumsum(steps, axis=1) - steps
    command = rng.uniform(0.0, 0.5, (TESTS, samples))
    return tuple(map(jnp.asarray, (travel, command, rng.uniform(60.0, 90.0, TESTS), np.zeros((TESTS, 1)))))


def simulated(model, *signals):
    return np.asarray(simulate_compensated(model, *signals, STEP_S))


def test_untrained_it_is_the_benchmark():
    travel, *others = made_up()
    np.testing.assert_array_equal(simulated(speed_compensator(trained=False), travel, *others), travel)


def test_a_benchmark_at_standstill_stays_there_whatever_was_learnt():
    travel, command, initial, load = made_up(samples=600)
    pause = np.full((TESTS, 6000), np.asarray(travel)[:, -1:])
    paused = jnp.asarray(np.concatenate([travel, pause], axis=1))
    silent = jnp.asarray(np.concatenate([command, np.zeros((TESTS, 6000))], axis=1))
    found = simulated(speed_compensator(size=5.0), paused, silent, initial, load)
    assert np.all(found[:, 599] != np.asarray(travel)[:, 599])
    np.testing.assert_array_equal(np.ptp(found[:, 600:], axis=1), 0.0)
    pushed = jnp.full_like(silent, 0.4)
    moved = simulated(speed_compensator(size=5.0), 0 * paused, pushed, initial, load)
    np.testing.assert_array_equal(moved, 0.0)


@given(
    seed=st.integers(0, 2**16),
    size=st.sampled_from([0.0, 0.1, 1.0, 10.0, 1e6]),
    direction=st.sampled_from([1, -1]),
)
def test_its_speed_is_within_half_of_the_benchmarks_for_any_weights(seed, size, direction):
    travel, *others = made_up(seed)
    found = simulated(speed_compensator(seed, size=size, direction=direction), travel, *others)
    ratio = np.diff(found, axis=1) / np.diff(np.asarray(travel), axis=1)
    # Travel up to 100 mm in steps of 1/1024 mm at least: what rounding makes of their ratio.
    rounding = 8 * EPS * float(travel.max()) / FINE
    assert ratio.max() <= 1 + SPEED_AUTHORITY + rounding
    assert ratio.min() >= 1 - SPEED_AUTHORITY - rounding
    assert SPEED_AUTHORITY == 0.5


@pytest.mark.parametrize("beyond", ["command", "displacement", "load"])
def test_outside_the_operating_range_it_moves_as_the_benchmark_does(beyond):
    ranges = {"command": (0.6, 0.7), "displacement": (900.0, 950.0), "load": (5.0, 6.0)}
    travel, *others = made_up()
    outside = speed_compensator(size=5.0, covered=envelope(**{beyond: ranges[beyond]}))
    np.testing.assert_array_equal(simulated(outside, travel, *others), travel)
    inside = simulated(speed_compensator(size=5.0), travel, *others)
    assert np.all(inside[:, 10:] != np.asarray(travel)[:, 10:])


def by_hand(model, travel, command, initial):
    """Return the compensated travel of one test, by the equations."""
    weights, biases, outputs = map(np.asarray, model.networks)
    covered = model.operating_range.displacement
    lowest, highest = float(covered.lowest), float(covered.highest)
    scales = np.array([model.command_scale, model.speed_scale, model.acceleration_scale])
    increments = np.append(np.diff(travel), 0.0)
    found, compensated, speed, acceleration = [], 0.0, 0.0, 0.0
    for sample in range(travel.size):
        found.append(compensated)
        scaled = np.array([command[sample], speed, acceleration]) / scales
        place = 2 * (initial + model.sign * compensated - lowest) / (highest - lowest) - 1
        inputs = np.array([*scaled, place, 0.0])  # the load's range has no width
        members = [
            np.tanh(v @ np.tanh(w @ inputs + b)) for w, b, v in zip(weights, biases, outputs, strict=True)
        ]
        compensated += increments[sample] * (1 + 0.5 * np.mean(members))
        next_speed = increments[sample] / STEP_S
        acceleration, speed = (next_speed - speed) / STEP_S, next_speed
    return np.array(found)


@pytest.mark.parametrize("direction", [1, -1])
def test_its_free_run_is_that_of_its_equations(direction):
    travel, command, initial, load = made_up(samples=60)
    model = speed_compensator(direction=direction, covered=envelope(displacement=(0.0, 200.0)))
    found = simulated(model, travel, command, initial, load)
    rows = zip(*map(np.asarray, (travel, command, initial)), strict=True)
    np.testing.assert_allclose(found, [by_hand(model, *row) for row in rows], rtol=1e-12, atol=1e-12)
    assert np.abs(found[:, -1] / np.asarray(travel)[:, -1] - 1).max() > 0.01


def test_what_comes_later_changes_nothing_before():
    travel, command, initial, load = made_up()
    model, late = speed_compensator(size=5.0), np.arange(SAMPLES) >= 120
    changed = jnp.asarray(np.where(late, 0.0, np.asarray(command)))
    stopped = jnp.asarray(np.where(late, np.asarray(travel)[:, 120:121], np.asarray(travel)))
    one = simulated(model, travel, command, initial, load)
    other = simulated(model, stopped, changed, initial, load)
    np.testing.assert_array_equal(one[:, :120], other[:, :120])
    assert np.all(one[:, 125:] != other[:, 125:])


def test_its_gradients_are_finite():
    travel, *others = made_up()

    def total(model):
        return jnp.sum(simulate_compensated(model, travel, *others, STEP_S))

    gradients = jax.grad(total, allow_int=True)(speed_compensator(size=50.0))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients.networks))
