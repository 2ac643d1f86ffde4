"""What is no stroke of this plant is not learned from, and how far its parameters may move."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import machine
from hitchid.live import AdaptationSettings, Adapter, Changes, StrokeCutter
from hitchid.live.events import FAULT, LEARNED, REFUSED
from hitchid.live.gates import SHORTEST_S, Bounds, rested_at, standstill_before
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model.limits import TravelLimits
from machine import DEAD_ZONES, DIRECTIONS, GAINS, LARGEST, MODEL, NOISE, REST, STEP_S

SAMPLES = 150  # of each of two levels
DURING, LATE = REST + SAMPLES, REST + SAMPLES + 50  # samples in the middle of a motion, and near its end


def with_missing(displacement, share, seed):
    """Return a displacement of which a share is missing."""
    missing = np.random.default_rng(seed).uniform(size=len(displacement)) < share
    return np.where(missing, np.nan, displacement)


def held(displacement, begin, end=None):
    """Return a displacement that stands still from one sample to another."""
    stuck = displacement.copy()
    stuck[begin:end] = stuck[begin]
    return stuck


def with_spikes(displacement, samples, sizes):
    spiked = displacement.copy()
    spiked[samples] += sizes
    return spiked


def creeping(displacement):
    """Return a displacement that moves by 1 mm/s before the command."""
    return displacement + np.minimum(np.arange(len(displacement)) - REST, 0) * STEP_S


def starved(displacement):
    """Return a displacement whose speed falls to a third in the middle of its last level."""
    slowed = displacement.copy()
    slowed[LATE:] = slowed[LATE] + (slowed[LATE:] - slowed[LATE]) / 3
    return slowed


CORRUPTED = {
    "stuck to the end": (lambda y: held(y, LATE), "stands still"),
    "stuck for 0.6 s": (lambda y: held(y, DURING, DURING + 60), "jumps by"),
    "jumped": (lambda y: y + 10.0 * (np.arange(len(y)) >= DURING), "jumps by"),
    "swapped": (lambda y: 200.0 - y, "moves against its command"),
    "dropped out": (lambda y: with_missing(y, 0.5, seed=1), "of the displacement is missing"),
    "all missing": (lambda y: np.full(len(y), np.nan), "100 % of the displacement is missing"),
    "spikes": (
        lambda y: with_spikes(y, [DURING - 20, DURING, DURING + 30], [15.0, -15.0, 15.0]),
        "outside of both its neighbours",
    ),
    # At a sample that free runs at half the sampling rate leave out.
    "a short spike": (lambda y: with_spikes(y, DURING | 1, 5.0), "outside of both its neighbours"),
    "creeping": (creeping, "does not start at rest: "),
    "starved": (starved, "% of the travel are left as error after gain and dead zone are fitted"),
}


@pytest.fixture(scope="module")
def adapter():
    return Adapter(MODEL, AdaptationSettings())


def refusal(adapter, stroke):
    """Return why a stroke is refused; nothing of what was learned may change by it."""
    before = adapter.initial_state()
    state, events = adapter.learn(before, stroke)
    if events[0].kind == LEARNED:
        return ""
    assert [event.kind for event in events] == [REFUSED]
    assert state.channels == before.channels
    assert state.strokes == 1
    return events[0].reason


# What another test left open may be collected here.
@pytest.mark.filterwarnings("error", "default::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("mode", DIRECTIONS)
@pytest.mark.parametrize("kind", CORRUPTED)
def test_a_corrupted_stroke_is_refused_and_says_why(adapter, kind, mode):
    corrupt, reason = CORRUPTED[kind]
    stroke = machine.stroke(mode, seed=11, samples=SAMPLES)
    corrupted = stroke._replace(displacement=corrupt(stroke.displacement))
    assert re.search(reason, refusal(adapter, corrupted))


def test_a_stroke_without_rest_or_of_both_commands_is_refused(adapter):
    stroke, kept = machine.stroke(seed=11), slice(REST - 5, None)
    short = stroke._replace(rest=5, commands=stroke.commands[kept], displacement=stroke.displacement[kept])
    assert "does not start at rest" in refusal(adapter, short)
    assert refusal(adapter, stroke._replace(direction="")) == "both commands are active"


@pytest.mark.parametrize("mode", DIRECTIONS)
@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("dead_zone", [-0.03, 0.0, 0.03])
def test_a_stroke_of_a_machine_that_changed_is_learned_from(adapter, mode, gain, dead_zone):
    stroke = machine.stroke(mode, seed=1, gain=gain, dead_zone=dead_zone)
    assert refusal(adapter, stroke) == ""
    few_missing = with_missing(stroke.displacement, 0.05, seed=2)
    assert refusal(adapter, stroke._replace(displacement=few_missing)) == ""


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_short_travels_and_commands_beyond_the_tests_are_refused(adapter, mode):
    def of_share(share):
        """Return the reason against a stroke with a share of the shortest travel."""
        travel = share * AdaptationSettings().shortest_travel * 120.0
        samples = round(travel / (0.2 * GAINS[mode] * STEP_S))
        return refusal(adapter, machine.stroke(mode, [0.2], samples=samples))

    assert of_share(1.1) == ""
    assert of_share(0.9).startswith("the travel is too short: ")
    assert refusal(adapter, machine.stroke(mode, [1.04 * LARGEST])) == ""
    beyond = refusal(adapter, machine.stroke(mode, [1.06 * LARGEST]))
    assert beyond.startswith("the command is outside the identified range: ")


@pytest.mark.parametrize("gain", [0.4, 1.6])
def test_a_gain_beyond_its_bounds_is_refused(adapter, gain):
    stroke = machine.stroke(seed=1, gain=gain, samples=200)
    assert "its own gain is beyond the largest change" in refusal(adapter, stroke)


def adapter_of(**more):
    """Return the adapter of a model that knows more of its lifting channel."""
    channel = replace(MODEL.channels[LIFTING], **more)
    return Adapter(replace(MODEL, channels={**MODEL.channels, LIFTING: channel}), AdaptationSettings())


def test_a_stroke_to_an_end_stop_needs_a_known_stop(adapter):
    stroke, stop = machine.stroke(seed=3), 110.0
    stopped = stroke._replace(displacement=np.minimum(stroke.displacement, stop))
    assert "stands still" in refusal(adapter, stopped)
    assert refusal(adapter_of(end_stop=stop), stopped) == ""


@pytest.mark.parametrize("stop", [True, False])
def test_a_stroke_beyond_the_logs_is_refused(stop):
    stroke = machine.stroke(seed=3)
    narrow, wide = (adapter_of(limits=TravelLimits(50.0, upper, False, stop)) for upper in (112.0, 200.0))
    assert refusal(narrow, stroke) == "it leaves the range of the logs, 48.76 to 113.2"
    assert refusal(wide, stroke) == ""


# --- standstill between two strokes -------------------------------------------------------------------------


def faults(adapter, strokes):
    """Return the faults of strokes of both valves, which tell nothing but where the piston rests."""
    state, events = adapter.initial_state(), []
    for stroke in strokes:
        state, happened = adapter.learn(state, stroke._replace(direction=""))
        events += happened
    return [event for event in events if event.kind == FAULT]


def test_after_a_stroke_that_was_cut_nothing_is_a_fault(adapter):
    commands = np.concatenate([machine.command(LIFTING, [0.1], 2600), machine.command(LOWERING, [0.4])])
    displacement = machine.moved(50.0, commands)
    strokes = StrokeCutter(MODEL).feed(commands, displacement)
    assert [len(stroke.displacement) for stroke in strokes] == [2000, 50 + 100 + machine.SETTLED]
    assert faults(adapter, strokes) == []


def test_at_a_slow_sampling_time_nothing_is_a_fault():
    slow = Adapter(replace(MODEL, step_s=0.1), AdaptationSettings())
    commands = np.concatenate(
        [machine.command(mode, [0.5], 20, rest=10, settled=3) for mode in (*DIRECTIONS, *DIRECTIONS)]
    )
    displacement = 100.0 + 10 * (machine.moved(100.0, commands) - 100.0)
    strokes = StrokeCutter(slow.model).feed(commands, displacement)
    assert len(strokes) == 4
    assert faults(slow, strokes) == []


def strokes_apart(seconds, change, seed=1):
    """Return two strokes with a standstill of so many seconds between them, over which the piston moves."""
    first = machine.stroke(seed=seed)
    start = float(machine.stroke().displacement[-1]) + change
    second = machine.stroke(LOWERING, start=start, seed=seed + 1, begin=first.end + round(seconds / STEP_S))
    return first, second


def standstill(first, second):
    return standstill_before(MODEL, second, first.end, rested_at(first, STEP_S))


@pytest.mark.parametrize("seconds", [SHORTEST_S, 36_000.0])
def test_the_leak_is_that_of_the_machine_within_its_deviation(seconds):
    leaks = [standstill(*strokes_apart(seconds, -3.0, seed)).leak for seed in range(0, 100, 2)]
    errors = [(leak["leak"] + 3.0 / seconds) / leak["leak_deviation"] for leak in leaks]
    assert np.max(np.abs(errors)) < 4
    assert leaks[0]["leak_deviation"] == pytest.approx(leaks[-1]["leak_deviation"])


def test_what_is_short_wrong_or_not_seen_shows_no_leak():
    assert standstill(*strokes_apart(0.9 * SHORTEST_S, -3.0)).leak == {}
    first, second = strokes_apart(60.0, 0.0)
    first.displacement[-3] += 40.0  # one sample at each end is wrong
    second.displacement[second.rest - 4] -= 40.0
    assert abs(standstill(first, second).change) < 4 * NOISE
    unseen = first._replace(displacement=np.full(len(first.displacement), np.nan))
    assert math.isnan(rested_at(unseen, STEP_S))
    assert standstill(unseen, second) is None


@pytest.mark.parametrize(("change", "is_fault"), [(10.0, True), (-10.0, True), (0.5, False), (0.0, False)])
def test_a_jump_at_rest_is_a_fault_and_no_leak(adapter, change, is_fault):
    first, second = strokes_apart(20.0, change)
    state, _ = adapter.learn(adapter.initial_state(), first)
    _, events = adapter.learn(state, second)
    judged = next(event for event in events if event.kind in (LEARNED, REFUSED))
    reasons = [event.reason for event in events if event.kind == FAULT]
    assert [f"changed by {change:+.0f}"[:12] in reason for reason in reasons] == [True] * is_fault
    assert ("leak" in judged.figures) != is_fault


# --- bounds of the changes: how far they go, how fast, and in which unit ------------------------------------

CHANNEL = MODEL.channels[LIFTING]
SETTINGS = AdaptationSettings(largest_dead_zone=0.5)  # share of the command: 0.25 A
BOUNDS = Bounds.of(CHANNEL, SETTINGS, "A")
CHANGES = st.builds(Changes, *(st.floats(*ends) for ends in zip(BOUNDS.lowest, BOUNDS.highest, strict=True)))


@pytest.mark.parametrize(("unit", "largest"), [("A", 0.15), ("mA", 0.5 * LARGEST), ("%", 0.5 * LARGEST)])
def test_a_dead_zone_moves_by_at_most_150_milliamperes(unit, largest):
    bounds = Bounds.of(CHANNEL, SETTINGS, unit)
    assert bounds.highest[1] == pytest.approx(largest, rel=1e-15)
    assert bounds.lowest[1] == pytest.approx(-min(largest, DEAD_ZONES[LIFTING]), rel=1e-15)


def test_what_is_beyond_its_bounds_is_held():
    assert BOUNDS.allowed.tolist() == [True, True, False]  # an integrator has no lag
    only = Bounds.of(CHANNEL, AdaptationSettings(parameters=("gain",)), "A")
    assert only.allowed.tolist() == [True, False, False]
    assert BOUNDS.beyond(np.array([0.3, 0.1, 0.0])) == ""
    assert BOUNDS.beyond(np.array([0.3, 0.16, 0.0])) == "dead zone"
    assert BOUNDS.beyond(np.array([-0.7, 0.16, 0.0])) == "gain"
    assert BOUNDS.clipped(np.array([-0.7, 0.16, 0.0])) == Changes(np.log1p(-0.5), BOUNDS.highest[1])


@given(CHANGES, CHANGES)
def test_steps_arrive_and_none_is_larger_than_the_largest(start, target):
    needed = int(np.ceil(np.max(np.abs(np.subtract(target, start)) / BOUNDS.step)))
    at = start
    for _ in range(needed + 1):  # rounding may cost one more
        before, at = at, BOUNDS.towards(at, target)
        rounding = 4 * np.finfo(float).eps
        assert np.all(np.abs(np.subtract(at, before)) <= BOUNDS.step + rounding)
    assert at is target
