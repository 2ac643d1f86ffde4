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


def divided(record, switches=None, scales=None):
    return [tuple(segment) for segment in segments(record, scales, switches)]


HUMP = [(50, 0.3, 0), (50, 0.4, 0), (50, 0.3, 0), (50, 0.2, 0)]
DIVIDED = {
    "commands lift, hold and lower": (
        [(50, 0, 0), (100, 1, 0), (60, 0, 0), (80, 0, 1), (40, 0, 0)],
        None,
        [("hold", 50), ("lifting", 150), ("hold", 210), ("lowering", 290), ("hold", 330)],
    ),
    "a command below the dead zone holds": (
        [(50, 0.3, 0), (50, 0.4, 0), (50, 0, 0.2), (50, 0, 0.3)],
        ZONES,
        [("hold", 50), ("lifting", 100), ("hold", 150), ("lowering", 200)],
    ),
    "a negative command works as well": (
        [(50, 0, 0), (50, -1, 0)],
        None,
        [("hold", 50), ("lifting", 100)],
    ),
    "both valves on": (
        [(50, 1, 0), (50, 1, 1), (50, 0, 1)],
        None,
        [("lifting", 50), ("both valves on", 100), ("lowering", 150)],
    ),
    "without hysteresis": (
        HUMP,
        {"lifting": CommandThreshold(0.35)},
        [("hold", 50), ("lifting", 100), ("hold", 200)],
    ),
    "hysteresis ends motion below where it began": (
        HUMP,
        {"lifting": CommandThreshold(0.35, hysteresis=0.1)},
        [("hold", 50), ("lifting", 150), ("hold", 200)],
    ),
}


@pytest.mark.parametrize(("levels", "switches", "ends"), DIVIDED.values(), ids=DIVIDED.keys())
def test_commands_divide_a_log(held, levels, switches, ends):
    assert [(label, stop) for label, _, stop in divided(held(*levels), switches)] == ends


def test_without_a_dead_zone_five_percent_of_full_scale_counts(held):
    record = held((50, 0.04, 0), (50, 1, 0), (50, 0, 0.06))
    assert [label for label, *_ in divided(record)] == ["hold", "lifting", "lowering"]
    scales = {"lifting": 2.0, "lowering": 2.0}
    assert divided(record, scales=scales) == [("hold", 0, 50), ("lifting", 50, 100), ("hold", 100, 150)]
    tiny = {mode: CommandThreshold(0.01) for mode in ZONES}
    assert divided(record, tiny) == divided(record)


@pytest.mark.parametrize("samples", [1, 30])
def test_dead_time_moves_both_edges(held, samples):
    late = {"lifting": CommandThreshold(0.35, dead_time_s=samples * STEP_S)}
    record = held((50, 0, 0), (100, 1, 0), (60, 0, 0))
    assert divided(record, late) == [
        ("hold", 0, 50 + samples),
        ("lifting", 50 + samples, 150 + samples),
        ("hold", 150 + samples, 210),
    ]


@pytest.mark.parametrize("samples", [50, 60, 100])
def test_a_dead_time_as_long_as_the_record_leaves_a_hold(held, samples):
    late = {"lifting": CommandThreshold(0.35, dead_time_s=samples * STEP_S)}
    assert divided(held((50, 1, 0)), late) == [("hold", 0, 50)]


def into_stop(held, *, standing, at=1.0, reach=20.0):
    """Return a piston lifted for 2 s that stands for some samples `at` a share of its way, and goes on."""
    before = np.linspace(0, at * reach, 200)
    after = np.linspace(at * reach, reach, 50) if at < 1 else np.full(50, reach)
    moved = np.concatenate([before, np.full(standing, at * reach), after])
    return held((200 + standing, 1, 0), (50, 1 if at < 1 else 0, 0), moved=moved)


WINDOW = round(0.3 / STEP_S)


def test_a_commanded_piston_at_the_end_is_at_an_end_stop(held):
    labels = divided(into_stop(held, standing=100))
    assert [label for label, *_ in labels] == ["lifting", "end stop", "hold"]
    # Over 0.3 s around a sample it moves by less than 10 %: from 10 % before the window's half has passed.
    assert 0 <= 200 + WINDOW / 2 - labels[1][1] <= 0.1 * WINDOW + 1
    assert labels[1][2] == 300


def test_a_commanded_piston_that_stands_elsewhere_is_held(held):
    labels = divided(into_stop(held, standing=100, at=0.5))
    assert [label for label, *_ in labels] == ["lifting", "hold", "lifting"]


def test_the_bottom_is_an_end_stop_to_what_lowers(held):
    moved = np.concatenate([np.linspace(0, 20, 200), np.linspace(20, 0, 200), np.zeros(100)])
    labels = divided(held((200, 1, 0), (300, 0, 1), moved=moved))
    assert [label for label, *_ in labels] == ["lifting", "lowering", "end stop"]


@pytest.mark.parametrize("standing", [WINDOW // 2, WINDOW])
def test_a_brief_standstill_is_no_end_stop(held, standing):
    labels = [label for label, *_ in divided(into_stop(held, standing=standing))]
    assert labels == ["lifting", "hold"]


def clipped(held, *, top, values=200):
    """Return a command that rises through many values, stands at its largest and falls again."""
    up = np.concatenate([np.linspace(0.2, 1, values), np.ones(top), np.linspace(1, 0.2, values)[1:]])
    return held(*((1, level, 0) for level in up))


def test_a_command_that_stands_at_its_largest_is_saturated(held):
    # The rise ends and the fall begins at the largest value, one sample each.
    assert divided(clipped(held, top=30)) == [
        ("lifting", 0, 199),
        ("saturated", 199, 230),
        ("lifting", 230, 429),
    ]


def test_other_large_commands_are_not_saturated(held):
    assert "saturated" not in {label for label, *_ in divided(clipped(held, top=3))}
    larger = {"lifting": 1.01, "lowering": 1.01}
    assert "saturated" not in {label for label, *_ in divided(clipped(held, top=30), scales=larger)}
    assert "saturated" not in {label for label, *_ in divided(clipped(held, top=30, values=20))}


def test_a_slow_clock_can_be_divided(held):
    labels = divided(held((5, 0, 0), (10, 1, 0), (5, 0, 0), step_s=1.0))
    assert labels == [("hold", 0, 5), ("lifting", 5, 15), ("hold", 15, 20)]


levels = st.sampled_from([0.0, 0.3, 0.5, 1.0])
pieces = st.lists(st.tuples(st.integers(1, 60), levels, levels), min_size=1, max_size=8)
switches = st.builds(CommandThreshold, st.floats(0, 0.6), st.floats(0, 0.3), st.floats(0, 0.5))


@given(pieces, st.fixed_dictionaries({}, optional={"lifting": switches, "lowering": switches}), st.data())
def test_segments_cover_every_sample_once_and_neighbours_differ(commands, thresholds, data):
    up = np.concatenate([np.full(n, up) for n, up, _ in commands])
    down = np.concatenate([np.full(n, down) for n, _, down in commands])
    speeds = data.draw(st.lists(st.sampled_from([-0.1, 0.0, 0.1]), min_size=1, max_size=5))
    speed = np.repeat(speeds, -(-up.size // len(speeds)))[: up.size]
    signals = {"displacement": np.cumsum(speed), "lifting_command": up, "lowering_command": down}
    units = {role: "mm" if role == "displacement" else "A" for role in signals}
    parts = segments(Record("test", STEP_S, signals, units), command_thresholds=thresholds)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == up.size
    assert all(part.stop > part.start for part in parts)
    assert all(one.label != two.label for one, two in pairwise(parts))
    assert {part.label for part in parts} <= set(LABELS)
    durations = durations_s(parts, STEP_S)
    assert set(durations) == {part.label for part in parts}
    # Each duration is rounded to a microsecond.
    assert sum(durations.values()) == pytest.approx(up.size * STEP_S, abs=1e-6 * len(LABELS))


def test_durations_add_up_what_is_called_alike():
    parts = [Segment("hold", 0, 30), Segment("lifting", 30, 80), Segment("hold", 80, 100)]
    assert durations_s(parts, 0.5) == {"lifting": 25.0, "hold": 25.0}
    assert durations_s([], 0.5) == {}
