"""Bounds of the changes: how far they go, how fast, and in which unit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import machine
from hitchid.live import AdaptationSettings, Changes
from hitchid.live.gates import Bounds
from hitchid.logs.record import LIFTING
from machine import DEAD_ZONES, LARGEST

CHANNEL = machine.MODEL.channels[LIFTING]
SETTINGS = AdaptationSettings(largest_dead_zone=0.5)  # share of the command: 0.25 A
BOUNDS = Bounds.of(CHANNEL, SETTINGS, "A")


@pytest.mark.parametrize(("unit", "largest"), [("A", 0.15), ("mA", 0.5 * LARGEST), ("%", 0.5 * LARGEST)])
def test_a_dead_zone_of_a_current_moves_by_at_most_150_milliamperes(unit, largest):
    bounds = Bounds.of(CHANNEL, SETTINGS, unit)
    assert bounds.highest[1] == pytest.approx(largest, rel=1e-15)
    assert bounds.lowest[1] == pytest.approx(-min(largest, DEAD_ZONES[LIFTING]), rel=1e-15)


def test_a_parameter_that_may_not_move_or_is_not_there_is_not_allowed():
    assert BOUNDS.allowed.tolist() == [True, True, False]  # an integrator has no lag
    only = Bounds.of(CHANNEL, AdaptationSettings(parameters=("gain",)), "A")
    assert only.allowed.tolist() == [True, False, False]


def test_what_is_beyond_has_its_name_and_is_held_at_the_bound():
    assert BOUNDS.beyond(np.array([0.3, 0.1, 0.0])) == ""
    assert BOUNDS.beyond(np.array([0.3, 0.16, 0.0])) == "dead zone"
    assert BOUNDS.beyond(np.array([-0.7, 0.16, 0.0])) == "gain"
    assert BOUNDS.clipped(np.array([-0.7, 0.16, 0.0])) == Changes(np.log1p(-0.5), BOUNDS.highest[1])


CHANGES = st.builds(Changes, *(st.floats(*ends) for ends in zip(BOUNDS.lowest, BOUNDS.highest, strict=True)))


@given(CHANGES, CHANGES)
def test_steps_arrive_and_none_is_larger_than_the_largest(start, target):
    needed = int(np.ceil(np.max(np.abs(np.subtract(target, start)) / BOUNDS.step)))
    at = start
    for _ in range(needed + 1):  # rounding may cost one more
        before, at = at, BOUNDS.towards(at, target)
        rounding = 4 * np.finfo(float).eps
        assert np.all(np.abs(np.subtract(at, before)) <= BOUNDS.step + rounding)
    assert at is target
