"""Strokes cut from a stream: the same however it comes in, and no more memory than one of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handmade
import machine
from hitchid.live import StrokeCutter
from hitchid.live.strokes import LONGEST_S
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.structures.batch import REST_SAMPLES
from machine import DEAD_ZONES, MODEL, SETTLED, STEP_S

LIFT, LOWER = (0.2 + DEAD_ZONES[LIFTING], 0.0), (0.0, 0.2 + DEAD_ZONES[LOWERING])
KINDS = {
    "rest": (0.0, 0.0),
    "lift": LIFT,
    "lower": LOWER,
    "both": (LIFT[0], LOWER[1]),
    "below": (0.5 * DEAD_ZONES[LIFTING], 0.5 * DEAD_ZONES[LOWERING]),
    "none": (np.nan, np.nan),
    "half": (LIFT[0], np.nan),
}
LONGEST = round(LONGEST_S / STEP_S)


def commands_of(*pieces):
    """Return pieces of (kind, samples) one after the other, shape [N, 2]."""
    return np.concatenate([np.tile(KINDS[kind], (samples, 1)) for kind, samples in pieces])


def numbered(commands):
    """Return a displacement that tells each sample from all others, shape [N]."""
    return np.arange(float(len(commands)))


def cut(commands, edges=()):
    """Return the strokes of a stream that comes in blocks between some edges."""
    cutter, strokes = StrokeCutter(MODEL), []
    blocks = np.split(commands, edges), np.split(numbered(commands), edges)
    for block, measured in zip(*blocks, strict=True):
        strokes += cutter.feed(block, measured)
    return strokes + cutter.finish()


def assert_same(strokes, expected):
    assert [stroke[:3] for stroke in strokes] == [stroke[:3] for stroke in expected]
    for one, other in zip(strokes, expected, strict=True):
        np.testing.assert_array_equal(one.commands, other.commands)
        np.testing.assert_array_equal(one.displacement, other.displacement)


PIECES = st.lists(st.tuples(st.sampled_from(list(KINDS)), st.integers(1, 90)), min_size=1, max_size=12)


@given(PIECES, st.lists(st.integers(0, 1000), max_size=12))
def test_where_blocks_begin_and_end_makes_no_difference(pieces, edges):
    commands = commands_of(*pieces)
    whole = cut(commands)
    assert_same(cut(commands, edges=sorted(edge for edge in edges if edge <= len(commands))), whole)
    assert_same(cut(commands, edges=np.arange(1, len(commands))), whole)


@given(PIECES)
def test_every_active_sample_is_in_one_stroke_of_its_direction(pieces):
    commands = commands_of(*pieces)
    directions = {"lift": LIFTING, "half": LIFTING, "lower": LOWERING, "both": ""}
    expected = [directions.get(kind) for kind, samples in pieces for _ in range(samples)]
    seen = np.zeros(len(commands), int)
    for stroke in cut(commands):
        samples = stroke.displacement.astype(int)
        assert samples[0] == stroke.begin - stroke.rest
        assert samples[-1] + 1 == stroke.end
        np.testing.assert_array_equal(np.diff(samples), 1)
        np.testing.assert_array_equal(stroke.commands, commands[samples])
        assert 0 <= stroke.rest <= REST_SAMPLES
        own = samples[stroke.rest :]
        assert expected[own[0]] == stroke.direction
        assert {expected[sample] for sample in own} <= {stroke.direction, None}
        assert {expected[sample] for sample in samples[: stroke.rest]} <= {None}
        seen[own] += 1
    assert np.all(seen[[kind is not None for kind in expected]] == 1)
    assert np.all(seen <= 1)


def test_a_stroke_ends_after_the_time_to_settle():
    commands = commands_of(("rest", 80), ("lift", 40), ("rest", 200))
    cutter = StrokeCutter(MODEL)
    until = 80 + 40 + SETTLED
    assert cutter.feed(commands[: until - 1], numbered(commands)[: until - 1]) == []
    assert cutter.moves
    (stroke,) = cutter.feed(commands[until - 1 : until], numbered(commands)[until - 1 : until])
    assert not cutter.moves
    assert (stroke.direction, stroke.begin, stroke.rest, stroke.end) == (LIFTING, 80, REST_SAMPLES, until)
    assert cutter.finish() == []


def test_a_turn_ends_a_stroke_and_a_pause_does_not():
    commands = commands_of(("lift", 40), ("rest", SETTLED - 1), ("lift", 40), ("rest", 7), ("lower", 40))
    up, down = cut(commands)
    turn = 80 + SETTLED - 1 + 7
    assert (up.direction, up.begin, up.rest, up.end) == (LIFTING, 0, 0, turn)
    assert (down.direction, down.begin, down.rest, down.end) == (LOWERING, turn, 7, turn + 40)
    # A command of both valves is a stroke of no direction.
    commands = commands_of(("rest", 9), ("lift", 40), ("both", 30), ("lower", 40), ("rest", SETTLED))
    assert [stroke.direction for stroke in cut(commands)] == [LIFTING, "", LOWERING]


def test_of_the_longest_stroke_the_rest_is_left_out():
    commands = commands_of(("rest", 50), ("lift", 2 * LONGEST), ("rest", SETTLED), ("lower", 20))
    long, next_one = cut(commands)
    assert len(long.displacement) == LONGEST
    assert (long.begin, long.rest) == (50, 50)
    assert next_one.begin == 50 + 2 * LONGEST + SETTLED
    assert next_one.displacement[next_one.rest] == next_one.begin


@pytest.mark.parametrize("kind", ["rest", "none", "lift"])
def test_memory_does_not_grow(kind):
    cutter = StrokeCutter(MODEL)
    block = commands_of((kind, 1000))
    for number in range(300):
        assert cutter.feed(block, np.full(1000, float(number))) == []
        assert sum(map(len, cutter._rows)) <= max(REST_SAMPLES, LONGEST * (kind == "lift"))
        assert len(cutter._rows) <= LONGEST / 1000 + 1


def test_a_direction_without_a_channel_has_no_strokes():
    cutter = StrokeCutter(handmade.hitch(modes=(LIFTING,), covered=machine.COVERED))
    commands = commands_of(("lower", 100), ("rest", SETTLED), ("both", 50))
    (stroke,) = [*cutter.feed(commands, numbered(commands)), *cutter.finish()]
    assert (stroke.direction, stroke.begin) == (LIFTING, 100 + SETTLED)
