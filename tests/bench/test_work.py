"""The bench at work: strokes within their places, the same for a seed, slower with less to lower."""

import numpy as np
import pytest
from benchmarks.adaptation.work import ENDS, work

from hitchid.bench import load_rig, rig_limits
from hitchid.errors import InputError
from hitchid.logs.record import LIFTING, LOWERING

COMMANDS = {LIFTING: (0.8, 1.0), LOWERING: (0.7, 0.9)}
DURATION_S = 40.0
RIG = load_rig("nominal")


@pytest.fixture(scope="module")
def at_work():
    """Return what the bench does with its own implement."""
    return work(RIG, COMMANDS, duration_s=DURATION_S, seed=3)


def test_a_seed_gives_the_same_strokes(at_work):
    again = work(RIG, COMMANDS, duration_s=DURATION_S, seed=3)
    np.testing.assert_array_equal(again.record.displacement, at_work.record.displacement)


def test_strokes_end_where_they_should(at_work):
    stroke_mm = 1e3 * rig_limits(RIG).stroke_m
    highest, lowest = ENDS[0][1] * stroke_mm, ENDS[1][0] * stroke_mm
    # At 20 mm/s the piston runs on for a tenth of a second until the valve is closed.
    assert lowest - 2 < at_work.truth.min() < at_work.truth.max() < highest + 2
    assert len(at_work.record) == len(at_work.truth) == round(100 * DURATION_S)


def test_a_lighter_implement_is_lowered_more_slowly(at_work):
    light = work(RIG, COMMANDS, duration_s=DURATION_S, seed=3, implement_kg=450.0)
    fastest = [np.diff(run.truth).min() for run in (at_work, light)]
    assert fastest[0] < fastest[1] < 0


def test_what_does_not_fit_the_samples_is_refused():
    with pytest.raises(InputError, match=r"^oil_degc: expected a number or 4000 numbers, got shape \(3,\)"):
        work(RIG, COMMANDS, duration_s=DURATION_S, oil_degc=np.array([5.0, 6.0, 7.0]))
