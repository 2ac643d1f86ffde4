"""What is no stroke of this plant is not learned from, and the reason says why."""

import re
from dataclasses import replace

import numpy as np
import pytest

import machine
from hitchid.live import AdaptationSettings, Adapter, StrokeCutter
from hitchid.live.events import FAULT, LEARNED, REFUSED
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model.limits import TravelLimits
from machine import DIRECTIONS, GAINS, MODEL, REST, STEP_S

SAMPLES = 150  # of each of two levels
DURING, LATE = REST + SAMPLES, REST + SAMPLES + 50  # samples in the middle of a motion, and near its end


def with_displacement(stroke, displacement):
    return stroke._replace(displacement=np.asarray(displacement, float))


def stuck(stroke):
    """Return a stroke whose sensor stands still for the last second of the motion."""
    found = stroke.displacement.copy()
    found[LATE:] = found[LATE]
    return with_displacement(stroke, found)


def stuck_for_a_while(stroke):
    """Return a stroke whose sensor stands still for 0.6 s and then goes on where the piston is."""
    found = stroke.displacement.copy()
    found[DURING : DURING + 60] = found[DURING]
    return with_displacement(stroke, found)


def jumped(stroke):
    return with_displacement(
        stroke, stroke.displacement + 10.0 * (np.arange(len(stroke.displacement)) >= DURING)
    )


def swapped(stroke):
    return with_displacement(stroke, 200.0 - stroke.displacement)


def dropped_out(stroke):
    missing = np.random.default_rng(1).uniform(size=len(stroke.displacement)) < 0.5
    return with_displacement(stroke, np.where(missing, np.nan, stroke.displacement))


def with_spikes(stroke):
    found = stroke.displacement.copy()
    found[[DURING - 20, DURING, DURING + 30]] += [15.0, -15.0, 15.0]
    return with_displacement(stroke, found)


def with_a_short_spike(stroke):
    """Return a stroke with one spike, at a sample that free runs at half the sampling rate leave out."""
    found = stroke.displacement.copy()
    found[DURING | 1] += 5.0
    return with_displacement(stroke, found)


def all_missing(stroke):
    return with_displacement(stroke, np.full(len(stroke.displacement), np.nan))


def creeping(stroke):
    """Return a stroke before which the piston moves by 1 mm/s."""
    before = np.minimum(np.arange(len(stroke.displacement)) - REST, 0) * STEP_S
    return with_displacement(stroke, stroke.displacement + before)


def without_rest(stroke):
    kept = slice(REST - 5, None)
    return stroke._replace(rest=5, commands=stroke.commands[kept], displacement=stroke.displacement[kept])


def starved(stroke):
    """Return a stroke whose speed falls to a third in the middle of its last level."""
    at, found = LATE, stroke.displacement.copy()
    found[at:] = found[at] + (found[at:] - found[at]) / 3
    return with_displacement(stroke, found)


CORRUPTED = {
    stuck: "stands still",
    stuck_for_a_while: "jumps by",
    jumped: "jumps by",
    swapped: "moves against its command",
    dropped_out: "of the displacement is missing",
    with_spikes: "outside of both its neighbours",
    with_a_short_spike: "outside of both its neighbours",
    all_missing: "100 % of the displacement is missing",
    creeping: "does not start at rest: ",
    without_rest: "does not start at rest",
    starved: "% of the travel are left as error after gain and dead zone are fitted",
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


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", DIRECTIONS)
@pytest.mark.parametrize("corrupt", CORRUPTED, ids=lambda each: each.__name__)
def test_a_corrupted_stroke_is_refused_and_says_why(adapter, corrupt, mode):
    good = machine.stroke(mode, seed=11, samples=SAMPLES)
    assert re.search(CORRUPTED[corrupt], refusal(adapter, corrupt(good)))


@pytest.mark.parametrize("mode", DIRECTIONS)
@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("dead_zone", [-0.03, 0.0, 0.03])
def test_a_stroke_of_a_machine_that_changed_is_learned_from(adapter, mode, gain, dead_zone):
    for seed in range(3):
        assert refusal(adapter, machine.stroke(mode, seed=seed, gain=gain, dead_zone=dead_zone)) == ""


def test_few_missing_samples_are_learned_from(adapter):
    stroke = machine.stroke(seed=1)
    missing = np.random.default_rng(2).uniform(size=len(stroke.displacement)) < 0.05
    assert refusal(adapter, with_displacement(stroke, np.where(missing, np.nan, stroke.displacement))) == ""


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_a_short_travel_is_refused(adapter, mode):
    shortest = AdaptationSettings().shortest_travel * 120.0
    for share, reason in ((0.9, "the travel is too short: "), (1.1, "")):
        samples = round(share * shortest / (0.2 * GAINS[mode] * STEP_S))
        found = refusal(adapter, machine.stroke(mode, [0.2], samples=samples))
        assert found.startswith(reason)
        assert bool(found) == bool(reason)


@pytest.mark.parametrize("mode", DIRECTIONS)
def test_a_command_beyond_the_tests_is_refused(adapter, mode):
    for level, reason in ((1.04, ""), (1.06, "the command is outside the identified range: ")):
        found = refusal(adapter, machine.stroke(mode, [level * machine.LARGEST]))
        assert found.startswith(reason)
        assert bool(found) == bool(reason)


@pytest.mark.parametrize("gain", [0.4, 1.6])
def test_a_gain_beyond_its_bounds_is_refused(adapter, gain):
    assert "its own gain is beyond the largest change" in refusal(
        adapter, machine.stroke(seed=1, gain=gain, samples=200)
    )


STOP = 110.0  # mm


def stopped():
    """Return a stroke that ends at a stop."""
    stroke = machine.stroke(seed=3)
    return with_displacement(stroke, np.minimum(stroke.displacement, STOP))


def adapter_of(**known):
    """Return the adapter of a model that knows more of its lifting channel."""
    channel = replace(MODEL.channels[LIFTING], **known)
    return Adapter(replace(MODEL, channels={**MODEL.channels, LIFTING: channel}), AdaptationSettings())


def test_a_stroke_to_an_end_stop_is_learned_from_where_the_stop_is_known(adapter):
    assert "stands still" in refusal(adapter, stopped())
    assert refusal(adapter_of(end_stop=STOP), stopped()) == ""


@pytest.mark.parametrize(
    ("upper", "stop", "reason"),
    [
        (112.0, True, "it leaves the range of the logs, 48.76 to 113.2"),
        (112.0, False, "it leaves the range of the logs, 48.76 to 113.2"),
        (200.0, True, ""),
    ],
)
def test_a_stroke_beyond_the_logs_is_refused(upper, stop, reason):
    known = adapter_of(limits=TravelLimits(50.0, upper, False, stop))
    assert refusal(known, machine.stroke(seed=3)) == reason


def test_a_stroke_of_both_commands_is_refused(adapter):
    both = machine.stroke()._replace(direction="")
    state, (event,) = adapter.learn(adapter.initial_state(), both)
    assert (event.kind, event.reason) == (REFUSED, "both commands are active")
    assert state.changes == adapter.initial_state().changes


def faults(adapter, strokes):
    """Return the faults of strokes of both valves, which tell nothing but where the piston rests."""
    state, found = adapter.initial_state(), []
    for stroke in strokes:
        state, events = adapter.learn(state, stroke._replace(direction=""))
        found += [event for event in events if event.kind == FAULT]
    return found


def test_after_a_stroke_that_goes_on_beyond_what_is_kept_of_it_nothing_is_a_fault(adapter):
    commands = np.concatenate([machine.command(LIFTING, [0.1], 2600), machine.command(LOWERING, [0.4])])
    displacement = machine.moved(50.0, commands)
    strokes = StrokeCutter(MODEL).feed(commands, displacement)
    assert [len(stroke.displacement) for stroke in strokes] == [2000, 50 + 100 + machine.SETTLED]
    assert faults(adapter, strokes) == []


def test_at_a_slow_sampling_time_what_is_before_rest_is_no_fault():
    slow = Adapter(replace(MODEL, step_s=0.1), AdaptationSettings())
    commands = np.concatenate(
        [machine.command(mode, [0.5], 20, rest=10, settled=3) for mode in (*DIRECTIONS, *DIRECTIONS)]
    )
    displacement = 100.0 + 10 * (machine.moved(100.0, commands) - 100.0)
    strokes = StrokeCutter(slow.model).feed(commands, displacement)
    assert len(strokes) == 4
    assert faults(slow, strokes) == []


def test_a_sensor_that_jumps_at_rest_is_a_fault(adapter):
    first = machine.stroke(seed=1)
    state, _ = adapter.learn(adapter.initial_state(), first)
    after = float(first.displacement[-1])
    for jump, said in ((10.0, True), (0.0, False)):
        again = machine.stroke(start=after + jump, seed=2, begin=first.end + REST)
        _, events = adapter.learn(state, again)
        assert any(event.kind == FAULT and f"{jump:+.1f}"[:2] in event.reason for event in events) == said
