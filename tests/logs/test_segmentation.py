"""What a mixed log does, stretch by stretch, told from its commands and where the piston stands."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.logs.kinds import LABELS, CommandThreshold, Segment, durations_s, segments
from hitchid.logs.record import Record

STEP_S = 0.01
ZONES = {"lifting": CommandThreshold(0.35), "lowering": CommandThreshold(0.25)}


@pytest.fixture
def held(make_record):
    """Return a function that holds commands for some samples each, from (samples, lifting, lowering)."""

    def make(*levels, moved=None, step_s=STEP_S):
        up = np.concatenate([np.full(n, float(up)) for n, up, _ in levels])
        down = np.concatenate([np.full(n, float(down)) for n, _, down in levels])
        piston = 100 + np.cumsum((up > 0.05) * 0.1 - (down > 0.05) * 0.1) if moved is None else moved
        return make_record(piston, up, down, step_s=step_s)

    return make


def found(record, switches=None, scales=None):
    return [tuple(each) for each in segments(record, scales, switches)]


def test_commands_lift_hold_and_lower(held):
    record = held((50, 0, 0), (100, 1, 0), (60, 0, 0), (80, 0, 1), (40, 0, 0))
    assert found(record) == [
        ("hold", 0, 50),
        ("lifting", 50, 150),
        ("hold", 150, 210),
        ("lowering", 210, 290),
        ("hold", 290, 330),
    ]


def test_a_command_below_the_dead_zone_holds(held):
    record = held((50, 0.3, 0), (50, 0.4, 0), (50, 0, 0.2), (50, 0, 0.3))
    assert found(record, ZONES) == [
        ("hold", 0, 50),
        ("lifting", 50, 100),
        ("hold", 100, 150),
        ("lowering", 150, 200),
    ]


def test_without_a_dead_zone_five_percent_of_the_largest_command_of_all_logs_counts(held):
    record = held((50, 0.04, 0), (50, 1, 0), (50, 0, 0.06))
    assert [label for label, *_ in found(record)] == ["hold", "lifting", "lowering"]
    scales = {"lifting": 2.0, "lowering": 2.0}
    assert found(record, scales=scales) == [("hold", 0, 50), ("lifting", 50, 100), ("hold", 100, 150)]
    tiny = {mode: CommandThreshold(0.01) for mode in ZONES}
    assert found(record, tiny) == found(record)


def test_a_negative_command_works_as_well(held):
    assert found(held((50, 0, 0), (50, -1, 0))) == [("hold", 0, 50), ("lifting", 50, 100)]


@pytest.mark.parametrize("samples", [1, 7, 30])
def test_dead_time_moves_both_edges(held, samples):
    late = {"lifting": CommandThreshold(0.35, dead_time_s=samples * STEP_S)}
    record = held((50, 0, 0), (100, 1, 0), (60, 0, 0))
    assert found(record, late) == [
        ("hold", 0, 50 + samples),
        ("lifting", 50 + samples, 150 + samples),
        ("hold", 150 + samples, 210),
    ]


@pytest.mark.parametrize("samples", [50, 60, 100])
def test_a_dead_time_as_long_as_the_record_leaves_a_hold(held, samples):
    late = {"lifting": CommandThreshold(0.35, dead_time_s=samples * STEP_S)}
    assert found(held((50, 1, 0)), late) == [("hold", 0, 50)]


def test_hysteresis_ends_motion_below_where_it_began(held):
    rising = (50, 0.3, 0), (50, 0.4, 0)
    falling = (50, 0.3, 0), (50, 0.2, 0)
    record = held(*rising, *falling)
    assert found(record, {"lifting": CommandThreshold(0.35)}) == [
        ("hold", 0, 50),
        ("lifting", 50, 100),
        ("hold", 100, 200),
    ]
    assert found(record, {"lifting": CommandThreshold(0.35, hysteresis=0.1)}) == [
        ("hold", 0, 50),
        ("lifting", 50, 150),
        ("hold", 150, 200),
    ]


def test_both_valves_on_is_a_label_of_its_own(held):
    record = held((50, 1, 0), (50, 1, 1), (50, 0, 1))
    assert found(record) == [("lifting", 0, 50), ("both valves on", 50, 100), ("lowering", 100, 150)]


def into_stop(held, *, standing, at=1.0, reach=20.0):
    """Return a piston lifted for 2 s that stands for some samples `at` a share of its way, and goes on."""
    before = np.linspace(0, at * reach, 200)
    after = np.linspace(at * reach, reach, 50) if at < 1 else np.full(50, reach)
    moved = np.concatenate([before, np.full(standing, at * reach), after])
    return held((200 + standing, 1, 0), (50, 1 if at < 1 else 0, 0), moved=moved)


WINDOW = round(0.3 / STEP_S)


def test_a_commanded_piston_that_stands_at_the_end_of_its_travel_is_at_an_end_stop(held):
    labels = found(into_stop(held, standing=100))
    assert [label for label, *_ in labels] == ["lifting", "end stop", "hold"]
    # Over 0.3 s around a sample it moves by less than 10 %: from 10 % before the window's half has passed.
    assert 0 <= 200 + WINDOW / 2 - labels[1][1] <= 0.1 * WINDOW + 1
    assert labels[1][2] == 300


def test_a_commanded_piston_that_stands_elsewhere_is_held(held):
    labels = found(into_stop(held, standing=100, at=0.5))
    assert [label for label, *_ in labels] == ["lifting", "hold", "lifting"]


def test_the_bottom_is_an_end_stop_to_what_lowers(held):
    moved = np.concatenate([np.linspace(0, 20, 200), np.linspace(20, 0, 200), np.zeros(100)])
    labels = found(held((200, 1, 0), (300, 0, 1), moved=moved))
    assert [label for label, *_ in labels] == ["lifting", "lowering", "end stop"]


@pytest.mark.parametrize("standing", [WINDOW // 2, WINDOW])
def test_a_piston_that_stands_briefly_at_the_end_is_not_at_an_end_stop(held, standing):
    labels = [label for label, *_ in found(into_stop(held, standing=standing))]
    assert labels == ["lifting", "hold"]


def clipped(held, *, top, values=200):
    """Return a command that rises through many values, stands at its largest and falls again."""
    up = np.concatenate([np.linspace(0.2, 1, values), np.ones(top), np.linspace(1, 0.2, values)[1:]])
    return held(*((1, level, 0) for level in up))


def test_a_command_of_many_values_that_stands_at_the_largest_is_saturated(held):
    # The rise ends and the fall begins at the largest value, one sample each.
    assert found(clipped(held, top=30)) == [
        ("lifting", 0, 199),
        ("saturated", 199, 230),
        ("lifting", 230, 429),
    ]


def test_a_command_that_is_larger_elsewhere_or_of_few_values_or_brief_is_not_saturated(held):
    assert "saturated" not in {label for label, *_ in found(clipped(held, top=3))}
    larger = {"lifting": 1.01, "lowering": 1.01}
    assert "saturated" not in {label for label, *_ in found(clipped(held, top=30), scales=larger)}
    assert "saturated" not in {label for label, *_ in found(clipped(held, top=30, values=20))}


def test_a_slow_clock_can_be_divided(held):
    labels = found(held((5, 0, 0), (10, 1, 0), (5, 0, 0), step_s=1.0))
    assert labels == [("hold", 0, 5), ("lifting", 5, 15), ("hold", 15, 20)]


levels = st.sampled_from([0.0, 0.3, 0.5, 1.0])
pieces = st.lists(st.tuples(st.integers(1, 60), levels, levels), min_size=1, max_size=8)
switches = st.builds(CommandThreshold, st.floats(0, 0.6), st.floats(0, 0.3), st.floats(0, 0.5))


@given(pieces, st.fixed_dictionaries({}, optional={"lifting": switches, "lowering": switches}), st.data())
def test_segments_cover_every_sample_once_in_order_and_neighbours_differ(commands, known, data):
    up = np.concatenate([np.full(n, up) for n, up, _ in commands])
    down = np.concatenate([np.full(n, down) for n, _, down in commands])
    speeds = data.draw(st.lists(st.sampled_from([-0.1, 0.0, 0.1]), min_size=1, max_size=5))
    speed = np.repeat(speeds, -(-up.size // len(speeds)))[: up.size]
    divided = segments(recorded(np.cumsum(speed), up, down), command_thresholds=known)
    assert [each.start for each in divided] == [0, *(each.stop for each in divided[:-1])]
    assert divided[-1].stop == up.size
    assert all(each.stop > each.start for each in divided)
    assert all(one.label != two.label for one, two in pairwise(divided))
    assert {each.label for each in divided} <= set(LABELS)
    durations = durations_s(divided, STEP_S)
    assert set(durations) == {each.label for each in divided}
    # Each duration is rounded to a microsecond.
    assert sum(durations.values()) == pytest.approx(up.size * STEP_S, abs=1e-6 * len(LABELS))


def recorded(displacement, lifting, lowering):
    signals = {"displacement": displacement, "lifting_command": lifting, "lowering_command": lowering}
    units = {role: "mm" if role == "displacement" else "A" for role in signals}
    return Record(name="test", step_s=STEP_S, signals=signals, units=units)


def test_durations_add_up_what_is_called_alike():
    divided = [Segment("hold", 0, 30), Segment("lifting", 30, 80), Segment("hold", 80, 100)]
    assert durations_s(divided, 0.5) == {"lifting": 25.0, "hold": 25.0}
    assert durations_s([], 0.5) == {}
