"""A free run stays within the range of the plant and says when it is held there."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.model import TravelLimits

displacements = st.floats(-1e6, 1e6)


def test_without_a_stop_limits_are_a_tenth_beyond_the_logs(make_record):
    records = [
        make_record(np.array([20.0, 40.0]), np.zeros(2)),
        make_record(np.array([30.0, 70.0]), np.zeros(2)),
    ]
    assert TravelLimits.of(records, {}) == TravelLimits(15.0, 75.0)
    assert TravelLimits.of(records, {1: 69.0}) == TravelLimits(15.0, 69.0, upper_stop=True)
    assert TravelLimits.of(records, {1: 30.0, -1: 60.0}) == TravelLimits(15.0, 75.0)
    assert TravelLimits.of(records, {-1: 21.0}) == TravelLimits(21.0, 75.0, lower_stop=True)


@given(st.lists(displacements, min_size=1, max_size=9), displacements)
def test_clipped_displacements_lie_within_limits_or_start(samples, start):
    limits = TravelLimits(-3.0, 8.0)
    held = np.asarray(limits.clip(jnp.asarray(samples), jnp.asarray(start)))
    assert np.all(held >= min(-3.0, start) - 1e-6 * abs(start))
    assert np.all(held <= max(8.0, start) + 1e-6 * abs(start))
    inside = (np.array(samples) > -3.0) & (np.array(samples) < 8.0)
    np.testing.assert_allclose(held[inside], np.array(samples)[inside], rtol=1e-6, atol=1e-30)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        (TravelLimits(0.0, 10.0), [True, False, True]),
        (TravelLimits(0.0, 10.0, lower_stop=True), [False, False, True]),
        (TravelLimits(0.0, 10.0, lower_stop=True, upper_stop=True), [False, False, False]),
    ],
)
def test_a_limit_that_is_no_stop_is_flagged_where_reached(limits, expected):
    assert limits.at_soft_limit(np.array([0.0, 5.0, 10.0])).tolist() == expected
    assert ("mechanical stop" in limits.sentence("mm")) == (limits.lower_stop or limits.upper_stop)
