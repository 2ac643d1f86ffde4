"""The reference: it brakes at its deceleration, arrives in the time of that, and never passes the target."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.control.controller import Reference, ReferenceLimits

STEP_S = 0.01
LIMITS = ReferenceLimits(jnp.array([15.0, 10.0]), jnp.array([180.0, 90.0]))


@jax.jit
def followed(targets, speeds, start):
    def advance(reference, row):
        after = LIMITS.step(reference, *row, STEP_S)
        return after, after

    return jax.lax.scan(advance, Reference.at_rest(start), (targets, speeds))[1]


def run(targets, speeds=0.0, start: float = 0.0) -> Reference:
    targets = jnp.asarray(targets, jnp.float64)
    speeds = jnp.broadcast_to(jnp.asarray(speeds, jnp.float64), targets.shape)
    return Reference(*map(np.asarray, followed(targets, speeds, jnp.asarray(start))))


@given(
    arrays(np.float64, 200, elements=st.floats(-200, 200)),
    arrays(np.float64, 200, elements=st.floats(-30, 30)),
    st.integers(1, 100),
)
def test_it_accelerates_no_faster_than_the_hitch_can(levels, speeds, held: int) -> None:
    reference = run(np.repeat(levels, held)[:200], speeds)
    np.testing.assert_allclose(np.diff(reference.position), STEP_S * reference.speed[1:], rtol=0, atol=1e-9)
    before = np.concatenate([[0.0], reference.speed[:-1]])
    upward = np.where(reference.speed == 0, before, reference.speed) > 0
    assert np.all(np.abs(reference.acceleration) <= np.where(upward, 180.0, 90.0) * (1 + 1e-9))
    beyond = (np.minimum(before, reference.speed) >= 15.0) | (np.maximum(before, reference.speed) <= -10.0)
    assert np.all(reference.acceleration[beyond] == 0)


@given(st.floats(-50, 50), st.floats(0, 200))
def test_a_standing_target_is_reached_for_good_and_not_passed(distance: float, start: float) -> None:
    target = start + distance
    reference = run(np.full(800, target), start=start)
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
    position = run(np.full(900, distance)).position
    arrived = STEP_S * (1 + np.flatnonzero(np.abs(position - distance) < 1e-6)[0])
    assert arrived == pytest.approx(braking_s, abs=2 * STEP_S)


@pytest.mark.parametrize("speed", [12.0, 3.0, -3.0, -8.0])
def test_a_ramp_is_followed_one_sample_ahead_of_its_target(speed: float) -> None:
    target = 5.0 + speed * STEP_S * np.arange(1500)
    reference = run(target, speed)
    np.testing.assert_allclose(reference.position[-300:], target[-300:] + speed * STEP_S, rtol=0, atol=1e-9)
    np.testing.assert_allclose(reference.speed[-300:], speed, atol=1e-7)
