"""What a record is, told from its commands: kinds, strokes, end stops."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchid.logs.kinds import (
    LEAD_IN_S,
    REST_S,
    SHORTEST_STROKE_S,
    SHORTEST_STROKE_SAMPLES,
    detect_kind,
    direction_signs,
    effective_command,
    full_scales,
    ramp_direction,
    split_by_direction,
    strokes,
)
from hitchid.logs.record import Record

STEP_S = 0.01
ZONES = {"lifting": 0.3, "lowering": 0.2}


def record_of(lifting, lowering=None, displacement=None):
    lifting = np.asarray(lifting, dtype=float)
    signals = {
        "displacement": np.arange(lifting.size, dtype=float) if displacement is None else displacement,
        "lifting_command": lifting,
    }
    if lowering is not None:
        signals["lowering_command"] = np.asarray(lowering, dtype=float)
    units = {role: "mm" if role == "displacement" else "A" for role in signals}
    return Record(name="test", step_s=STEP_S, signals=signals, units=units)


def held(*levels):
    """Return commands held for some samples each, from (samples, lifting, lowering)."""
    return record_of(
        np.concatenate([np.full(n, up) for n, up, _ in levels]),
        np.concatenate([np.full(n, down) for n, _, down in levels]),
    )


levels = st.sampled_from([0.0, 0.1, 0.5, 1.0])
duty_cycles = st.lists(st.tuples(st.integers(1, 150), levels, levels), min_size=1, max_size=12)


@given(arrays(np.float64, 20, elements=st.floats(-10, 10)), st.floats(0, 5))
def test_the_effective_command_is_what_lies_beyond_the_dead_zone(command, dead_zone):
    effective = effective_command(command, dead_zone)
    np.testing.assert_array_equal(np.abs(effective), np.maximum(np.abs(command) - dead_zone, 0))
    assert np.all(effective * command >= 0)
    np.testing.assert_array_equal(effective_command(-command, dead_zone), -effective)


@pytest.mark.parametrize(
    ("record", "kind"),
    [
        (held((50, 0, 0), (100, 1, 0)), "lifting"),
        (held((50, 0, 0), (100, 0, 1)), "lowering"),
        (held((50, 0, 0), (100, 1, 0), (100, 0, 1)), "cycle"),
        (held((50, 0, 0), (100, 1, 0.04)), "lifting"),
        (held((150, 0.04, 0.04)), "idle"),
        (held((150, 0, 0)), "idle"),
        (held((148, 0, 0), (2, 1, 0)), "idle"),
        (held((147, 0, 0), (3, 1, 0)), "lifting"),
        (held((147, 1, 0), (3, 0, -1)), "cycle"),
        (record_of(np.linspace(0, 1, 500)), "ramp"),
        (record_of(np.linspace(0, 1, 500), np.zeros(500)), "ramp"),
        (record_of(np.zeros(500), np.linspace(0, 1, 500)), "ramp"),
        (record_of(np.concatenate([np.zeros(100), np.linspace(0, 1, 500), np.zeros(100)])), "ramp"),
        (record_of(np.linspace(0, 1, 150)), "lifting"),
        (record_of(np.linspace(0.5, 1, 500)), "lifting"),
        (record_of(np.repeat([0.0, 1.0, 0.5, 1.0], 100)), "lifting"),
        (record_of(-np.ones(100)), "lifting"),
    ],
)
def test_what_a_record_is_follows_from_its_commands(record, kind):
    assert detect_kind(record, dict.fromkeys(record.directions, 1.0)) == kind


def test_five_percent_is_of_the_campaigns_command_not_the_records():
    record = held((50, 0, 0), (100, 0.04, 0))
    assert detect_kind(record, full_scales([record])) == "lifting"
    assert detect_kind(record, full_scales([record, held((50, 0, -1))])) == "idle"


def test_full_scale_is_the_largest_command_of_either_valve():
    weak, strong = held((5, 0.2, 0.01)), held((5, 0.3, -2.0))
    assert full_scales([weak, strong]) == {"lifting": 2.0, "lowering": 2.0}
    percent = replace(strong, units={**strong.units, "lifting_command": "percent"})
    assert full_scales([percent]) == {"lifting": 0.3, "lowering": 2.0}


def test_a_ramp_is_of_the_mode_with_the_larger_command():
    up = np.linspace(0, 1, 500)
    assert ramp_direction(record_of(up, 0.01 * up)) == "lifting"
    assert ramp_direction(record_of(0.01 * up, up)) == "lowering"


def test_where_both_commands_are_effective_lowering_counts():
    record = record_of([0, 0.3, 0.4, 0.4, 0.0], [0, 0.2, 0.0, 0.3, 0.3])
    np.testing.assert_array_equal(direction_signs(record, ZONES), [0, 0, 1, -1, -1])


@given(duty_cycles)
def test_mode_changes_cover_every_sample_once_and_alternate(pieces):
    record = held(*pieces)
    stretches = split_by_direction(record, ZONES)
    assert [stretches[0].start, *(stroke.stop for stroke in stretches)] == [
        *(stroke.start for stroke in stretches),
        len(record),
    ]
    assert stretches[0].start == 0
    assert all(stroke.stop > stroke.start for stroke in stretches)
    assert all(one.direction != two.direction for one, two in pairwise(stretches))


@pytest.mark.parametrize("divide", [split_by_direction, strokes])
@given(duty_cycles)
def test_during_a_stretch_no_other_mode_has_an_effect(divide, pieces):
    record = held(*pieces)
    direction = direction_signs(record, ZONES)
    for stroke in divide(record, ZONES):
        assert set(direction[stroke.start : stroke.stop]) <= {0, 1 if stroke.direction == "lifting" else -1}


def test_a_hold_belongs_to_the_stroke_before_it():
    record = held((10, 0, 0), (20, 0, 1), (30, 0, 0), (40, 1, 0), (50, 0, 0))
    stretches = [(s.direction, s.start, s.stop) for s in split_by_direction(record, ZONES)]
    assert stretches == [("lowering", 0, 60), ("lifting", 60, 150)]


def test_a_record_at_rest_is_one_stretch_and_no_stroke():
    record = held((100, 0.1, 0.1))
    assert [(s.start, s.stop) for s in split_by_direction(record, ZONES)] == [(0, 100)]
    assert strokes(record, ZONES) == []


@given(duty_cycles)
def test_strokes_are_ordered_and_last_half_a_second(pieces):
    record = held(*pieces)
    edges = [edge for stroke in strokes(record, ZONES) for edge in (stroke.start, stroke.stop)]
    assert edges == sorted(edges)
    assert all(0 <= edge <= len(record) for edge in edges)
    for stroke in strokes(record, ZONES):
        assert (stroke.stop - stroke.start) * STEP_S >= SHORTEST_STROKE_S - 1e-12


BRIEF, PAUSE = round(SHORTEST_STROKE_S / STEP_S) // 2, round(REST_S / STEP_S) - 1
LEAD = round(LEAD_IN_S / STEP_S)
CUTS = {
    "a brief stroke is left out": (
        held((100, 1, 0), (BRIEF, 0, 1), (100, 1, 0)),
        [("lifting", 0, 100), ("lifting", 100 + BRIEF, 200 + BRIEF)],
    ),
    "no rest between directions": (
        held((100, 1, 0), (100, 0, 1)),
        [("lifting", 0, 100), ("lowering", 100, 200)],
    ),
    "a lead before the command after a rest": (
        held((100, 0, 0), (100, 1, 0), (80, 0, 0), (100, 0, 1)),
        [("lifting", 100 - LEAD, 280 - LEAD), ("lowering", 280 - LEAD, 380)],
    ),
    "a pause shorter than a rest cuts nothing": (
        held((20, 0, 0), (100, 1, 0), (PAUSE, 0, 0), (100, 1, 0)),
        [("lifting", 10, 220 + PAUSE)],
    ),
}


@pytest.mark.parametrize(("record", "expected"), CUTS.values(), ids=CUTS.keys())
def test_strokes_begin_and_end_where_their_commands_do(record, expected):
    assert [(s.direction, s.start, s.stop) for s in strokes(record, ZONES)] == expected


def test_a_stroke_of_few_samples_is_left_out():
    record = replace(held((20, 1, 0), (SHORTEST_STROKE_SAMPLES - 1, 0, 1), (20, 1, 0)), step_s=2.0)
    assert [stroke.direction for stroke in strokes(record, ZONES)] == ["lifting", "lifting"]
