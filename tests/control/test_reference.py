"""The reference: within its limits, the fastest way to a target, and never past it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.control.reference import Reference, ReferenceLimits

STEP_S = 0.01
# With these lags a speed grows from rest as fast as it falls.
LIMITS = ReferenceLimits(jnp.array([15.0, 10.0]), jnp.array([15 / 180, 10 / 90]), jnp.array([180.0, 90.0]))


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
def test_speed_and_acceleration_stay_within_their_limits(levels, speeds, each: int) -> None:
    found = run(np.repeat(levels, each)[:200], speeds)
    assert found.speed.max() <= 15.0 + 1e-9
    assert found.speed.min() >= -10.0 - 1e-9
    before = np.concatenate([[0.0], found.speed[:-1]])
    upward = np.where(before == 0, found.speed > 0, before > 0)
    change = np.abs(found.speed - before) / STEP_S
    assert np.all(change <= np.where(upward, 180.0, 90.0) * (1 + 1e-9))
    np.testing.assert_allclose(found.acceleration, (found.speed - before) / STEP_S, atol=1e-9)


@given(st.floats(-50, 50), st.floats(0, 200))
def test_a_standing_target_is_reached_for_good_and_not_passed(distance: float, start: float) -> None:
    target = start + distance
    position = run(np.full(800, target), start=start).position
    beyond = np.sign(distance) * (position - target)
    assert beyond.max() <= 180.0 * STEP_S**2 / 8  # the bound of the docstring
    np.testing.assert_allclose(position[-200:], target, rtol=0, atol=1e-12)
    assert np.ptp(position[-200:]) <= 1e-12


@pytest.mark.parametrize("target", [20.0, -20.0, 0.37])
def test_a_reference_at_its_target_stands(target: float) -> None:
    found = run(np.full(400, target))
    assert found.position[-1] == target
    assert np.all(found.speed[-50:] == 0)
    assert np.all(found.acceleration[-50:] == 0)


@pytest.mark.parametrize("distance", [60.0, 20.0, 5.0, 0.5, -60.0, -20.0, -5.0, -0.5])
def test_the_way_takes_no_longer_than_a_hitch_of_this_lag_needs(distance: float) -> None:
    """A trapezoid is a bound; a lag τ costs τ, and braking half its time, where full speed is reached."""
    speed, acceleration = (15.0, 180.0) if distance > 0 else (10.0, 90.0)
    size = abs(distance)
    if size >= speed**2 / acceleration:
        ideal = size / speed + speed / acceleration
    else:
        ideal = 2 * np.sqrt(size / acceleration)
    position = run(np.full(900, distance)).position
    arrived = STEP_S * (1 + np.flatnonzero(np.abs(position - distance) < 1e-6)[0])
    lagged = size / speed + 1.5 * speed / acceleration
    assert ideal - STEP_S < arrived <= lagged + 2.5 * STEP_S
    if size >= 20:
        assert arrived >= lagged - 2.5 * STEP_S


@pytest.mark.parametrize("speed", [12.0, 3.0, -3.0, -8.0])
def test_a_ramp_is_followed_one_sample_ahead_of_its_target(speed: float) -> None:
    target = 5.0 + speed * STEP_S * np.arange(1500)
    found = run(target, speed)
    np.testing.assert_allclose(found.position[-300:], target[-300:] + speed * STEP_S, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.speed[-300:], speed, atol=1e-7)
