"""A limit of speed against strokes of a machine that has one, and of machines that have none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import machine
from hitchid.live import Changes
from hitchid.live.stroke_errors import LIMITS, StrokeErrors, speed_limit
from hitchid.logs.record import LIFTING
from machine import MODEL, NOISE, STEP_S

CHANNEL = MODEL.channels[LIFTING]
ERRORS = StrokeErrors(CHANNEL, STEP_S, np.zeros(0), 1)
VARIANCE = NOISE**2 + (0.01 * 20.0) ** 2  # mm²: a hundredth of a travel of 20 mm is the usual misfit
GAINS = np.log(np.linspace(0.5, 1.2, 71))  # of which one fits a stroke to half a percent


def limited(stroke, limit, seed):
    """Return a stroke whose speed is at most a share of its fastest, with the noise of the sensor."""
    speed = np.diff(stroke.displacement, prepend=stroke.displacement[0])
    moved = stroke.displacement[0] + np.cumsum(np.minimum(speed, limit * speed.max()))
    return stroke._replace(
        displacement=moved + NOISE * np.random.default_rng(seed).standard_normal(moved.size)
    )


def limit_of(stroke):
    """Return the limit of speed that explains a stroke better than the best of the gains."""
    runs = ERRORS.runs(stroke, [Changes(), *(Changes(float(gain)) for gain in GAINS)])
    return speed_limit(runs, 0, 1 + int(np.argmin(runs.mean_squares[1:])), VARIANCE)


@pytest.mark.parametrize("limit", [0.4, 0.6, 0.8])
def test_the_limit_is_that_of_the_machine(limit):
    found = limit_of(limited(machine.stroke(levels=(0.15, 0.45)), limit, seed=2))
    # The limits that are tried are 0.025 apart.
    assert found == pytest.approx(limit, abs=LIMITS[1] - LIMITS[0])


@given(st.floats(0.6, 1.2), st.floats(0.1, 0.45), st.floats(0.1, 0.45), st.integers(0, 1000))
def test_another_gain_is_no_limit_whatever_the_levels(gain, first, second, seed):
    assert limit_of(machine.stroke(levels=(first, second), gain=gain, seed=seed)) == 1.0


def test_at_one_level_a_limit_is_not_told_from_another_gain():
    assert limit_of(limited(machine.stroke(levels=(0.3, 0.3)), 0.7, seed=2)) == 1.0
