"""Adaptation stroke by stroke: a machine that changes is followed, within bounds; undone, and done again."""

import math
from dataclasses import asdict, replace

import jax.monitoring
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import handmade
import machine
from hitchid.errors import InputError
from hitchid.live import AdaptationSettings, Adapter, Changes, Event, read_events
from hitchid.live.events import (
    CANDIDATE,
    CHANGE_DETECTED,
    KINDS,
    LEARNED,
    LONGEST_S,
    MOST_STROKES,
    MOVED,
    PROMOTED,
    REFUSED,
    ROLLED_BACK,
)
from hitchid.logs.record import LIFTING, LOWERING
from machine import DEAD_ZONES, DIRECTIONS, LARGEST, REST

MODEL = handmade.with_bands(machine.MODEL, *DIRECTIONS)
SCATTER = AdaptationSettings().gain_scatter
TIGHT = AdaptationSettings(largest_gain=0.1, largest_dead_zone=0.02, change_per_stroke=0.02, evidence=2.0)


@pytest.fixture(scope="module")
def adapter():
    prepared = Adapter(MODEL, AdaptationSettings())
    prepared.prepare()
    return prepared


def learned(adapter, strokes, state=None):
    """Return the states after each of some strokes, that before them first, and the events of each."""
    states, happened = [adapter.initial_state() if state is None else state], []
    for stroke in strokes:
        state, events = adapter.learn(states[-1], stroke)
        states.append(state)
        happened.append(events)
    return states, happened


def kinds(happened, kind):
    return [event for events in happened for event in events if event.kind == kind]


def gains(state):
    """Return the factors on the gains in use."""
    return [float(np.exp(changes.gain)) for changes in state.changes.values()]


CHANGED = machine.strokes(20, seed=7, scatter=SCATTER, changed_at=8, gain=1.15)


@pytest.fixture(scope="module")
def run(adapter):
    """Return states and events over strokes of a machine whose gain grows by 15 %."""
    return learned(adapter, CHANGED)


def test_a_stroke_compiles_nothing_once_it_is_prepared(adapter):
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, *_, **__: compiled.append(name) if "compile" in name or "trace" in name else None
    )
    try:
        learned(adapter, CHANGED[:2])
        assert compiled == []
    finally:
        jax.monitoring.clear_event_listeners()


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("gain", [0.85, 1.15])
def test_a_change_of_the_gain_is_followed_within_five_strokes(adapter, gain, seed):
    """Of each direction."""
    strokes = machine.strokes(18, seed=seed, scatter=SCATTER, changed_at=8, gain=gain)
    # A candidate is fitted to one stroke or more, each of which is off by its scatter.
    assert gains(learned(adapter, strokes)[0][-1]) == pytest.approx([gain, gain], rel=3 * SCATTER)


# A candidate that is no better reaches a likelihood ratio of 100 with a probability of 1 % (Ville 1939), and
# every second stroke of a direction makes one: of 40 strokes at most 20, of which 0.2 are promoted.
@pytest.mark.parametrize(("scatter", "most"), [(0.0, 0), (SCATTER, 1)])
def test_a_machine_that_stays_is_left_as_it_is(adapter, scatter, most):
    states, happened = learned(adapter, machine.strokes(40, seed=4, scatter=scatter))
    assert len(kinds(happened, LEARNED)) == 40
    assert kinds(happened, REFUSED) == kinds(happened, CHANGE_DETECTED) == []
    assert len(kinds(happened, PROMOTED)) <= most
    assert list(map(gains, states)) == 41 * [pytest.approx([1.0, 1.0], abs=2 * scatter)]


SUDDEN_GAIN = 1.3  # twenty standard deviations of the scatter


def test_a_single_stroke_far_from_the_others_is_refused_afterwards(adapter):
    before = machine.strokes(6, seed=5, scatter=SCATTER)
    odd = machine.stroke(
        start=before[-1].displacement[-1], seed=6, begin=before[-1].end + REST, gain=SUDDEN_GAIN
    )
    after = machine.stroke(start=odd.displacement[-1], seed=7, begin=odd.end + REST)
    states, _ = learned(adapter, before)
    suspecting, events = adapter.learn(states[-1], odd)
    channel = suspecting.channels[LIFTING]
    assert [number for number, _ in channel.suspects] == [7]
    assert [(event.kind, event.strokes) for event in events] == [(LEARNED, ()), (CANDIDATE, (7,))]
    assert [trial.after_change for trial in channel.candidates] == [True]
    for name in ("estimate", "window", "scatter"):
        assert getattr(channel, name) is getattr(states[-1].channels[LIFTING], name)

    state, events = adapter.learn(suspecting, after)
    (refused,) = kinds([events], REFUSED)
    assert (refused.stroke, refused.reason) == (7, "it is far from the strokes before and after it")
    channel = state.channels[LIFTING]
    assert channel.suspects == ()
    assert not any(trial.after_change for trial in channel.candidates)
    assert [number for number, _ in channel.window] == [1, 3, 5, 8]
    assert state.changes == {mode: Changes() for mode in DIRECTIONS}


def test_a_sudden_change_is_promoted_with_its_second_stroke(adapter):
    strokes = machine.strokes(12, seed=5, scatter=SCATTER, changed_at=8, gain=SUDDEN_GAIN)
    states, happened = learned(adapter, strokes)
    promoted = kinds(happened, PROMOTED)
    assert [(event.stroke, event.direction) for event in promoted] == [(11, LIFTING), (12, LOWERING)]
    assert kinds(happened, REFUSED) == []
    for mode, event in zip(DIRECTIONS, promoted, strict=True):
        assert np.exp(event.changes.gain) == pytest.approx(SUDDEN_GAIN, rel=3 * SCATTER)
        # What was learned before the change no longer counts.
        numbers = [number for number, _ in states[-1].channels[mode].window]
        assert numbers == [event.stroke - 2, event.stroke]


def at_one_level(levels, speed):
    """Return lifting strokes of one level each, A; their speed, over the model's, is a function of it."""
    strokes = []
    for number, level in enumerate(levels):
        samples = round(2 * 100 * 0.3 / level)
        begin = REST if not strokes else strokes[-1].end + REST
        options = {"samples": samples, "gain": speed(level), "seed": 20 + number, "begin": begin}
        strokes.append(machine.stroke(LIFTING, [level], start=60.0, **options))
    return strokes


def promotions(adapter, levels, speed):
    """Return the numbers of the strokes after which lifting is promoted, after four as the model is."""
    strokes = at_one_level([0.2, 0.4, 0.25, 0.35], lambda level: 1.0) + at_one_level(levels, speed)
    return [event.stroke for event in kinds(learned(adapter, strokes)[1], PROMOTED)]


def test_at_one_level_a_change_is_promoted_later(adapter):
    assert promotions(adapter, [0.3, 0.4], lambda level: 1.3)[:1] == [6]
    assert promotions(adapter, [0.3] * 7, lambda level: 1.3)[:1] == [10]
    # A starved pump: each level has the same speed, here that of 0.22 A.
    levels = [0.3, 0.31, 0.44, 0.35, 0.3, 0.42, 0.33]
    assert promotions(adapter, levels, lambda level: 0.22 / level) == []


def test_the_share_outside_is_a_figure_of_bands(adapter, run):
    shares = [event.figures["outside"] for event in kinds(run[1], LEARNED)]
    assert all(0 <= share <= 1 for share in shares)
    bare = Adapter(machine.MODEL, AdaptationSettings())
    _, (event, *_) = bare.learn(bare.initial_state(), CHANGED[0])
    assert event.kind == LEARNED
    assert "outside" not in event.figures


def assert_within(states, happened, limits):
    """Check the bounds of parameters and of their steps; a rollback is a step of its own."""
    rounding = 4 * float(np.finfo(np.float64).eps)
    step = np.array([np.log1p(limits.change_per_stroke), limits.change_per_stroke * LARGEST, np.inf])
    for mode in DIRECTIONS:
        changes = np.array([state.changes[mode] for state in states])
        assert np.all(np.abs(np.expm1(changes[:, 0])) <= limits.largest_gain + rounding)
        assert np.all(np.abs(changes[:, 1]) <= limits.largest_dead_zone * LARGEST + rounding)
        assert np.all(changes[:, 1] >= -DEAD_ZONES[mode])
        assert np.all(changes[:, 2] == 0.0)
        back = [
            any(event.kind == ROLLED_BACK and event.direction == mode for event in events)
            for events in happened
        ]
        steps = np.diff(changes, axis=0)[~np.array(back, bool)]
        assert np.all(np.abs(steps) <= step + rounding)
        assert np.all(np.abs(np.expm1(steps[:, 0])) <= limits.change_per_stroke + rounding)


PIECES = st.lists(
    st.tuples(st.floats(0.3, 2.0), st.floats(-0.1, 0.1), st.integers(1, 6), st.integers(0, 2**16)),
    min_size=1,
    max_size=4,
)


@settings(max_examples=10)
@given(PIECES, st.sampled_from([AdaptationSettings(), TIGHT]))
def test_whatever_the_strokes_are_bounds_hold(pieces, limits):
    strokes = [
        stroke
        for gain, dead_zone, count, seed in pieces
        for stroke in machine.strokes(count, seed=seed, gain=gain, dead_zone=dead_zone)
    ]
    assert_within(*learned(Adapter(MODEL, limits), strokes), limits)


@pytest.mark.parametrize("gain", [0.93, 1.08])
def test_bounds_are_reached_in_small_steps(gain):
    states, happened = learned(Adapter(MODEL, TIGHT), machine.strokes(16, seed=3, gain=gain))
    assert kinds(happened, PROMOTED)
    assert len(kinds(happened, MOVED)) > 4
    assert_within(states, happened, TIGHT)
    assert gains(states[-1]) == pytest.approx([gain, gain], rel=SCATTER)


def test_a_promotion_is_proved_on_strokes_after_the_candidate(run):
    _, happened = run
    (first, *_) = promoted = kinds(happened, PROMOTED)
    assert {event.direction for event in promoted} == set(DIRECTIONS)
    candidates = {(event.direction, event.changes): event for event in kinds(happened, CANDIDATE)}
    for event in promoted:
        candidate = candidates[event.direction, event.changes]
        assert max(candidate.strokes) <= candidate.stroke < event.stroke
    assert first.stroke > 8


def test_the_log_says_what_is_in_use_after_each_stroke(run):
    states, happened = run
    in_use = {mode: Changes() for mode in DIRECTIONS}
    for state, events in zip(states[1:], happened, strict=True):
        for event in events:
            if event.kind in (MOVED, ROLLED_BACK):
                in_use[event.direction] = event.changes
        assert state.changes == in_use


def test_the_log_is_gone_on_from_bit_for_bit(adapter, run, tmp_path):
    states, happened = run
    lines = []
    for state, events in zip(states[1:], happened, strict=True):
        lines += [event.to_json() + "\n" for event in events]
        (tmp_path / "changes.jsonl").write_text("".join(lines))
        resumed = adapter.resumed(read_events(tmp_path / "changes.jsonl"))
        for name in ("changes", "band_factors", "strokes"):
            assert getattr(resumed, name) == getattr(state, name)
        for mode in DIRECTIONS:
            assert resumed.channels[mode].target == state.channels[mode].target
        assert adapter.adapted(resumed).provenance == adapter.adapted(state).provenance
    back, event = adapter.rollback(states[-1], LOWERING)
    resumed = adapter.resumed([*(event for events in happened for event in events), event])
    assert resumed.changes == back.changes
    assert resumed.channels[LOWERING].snapshots == back.channels[LOWERING].snapshots


def test_rolling_back_restores_what_was_before_bit_for_bit(adapter, run):
    states, _ = run
    state, snapshots = states[-1], states[-1].channels[LIFTING].snapshots
    assert len(snapshots) >= 2
    other = state.channels[LOWERING]
    for expected in [*snapshots[-2::-1], Changes()]:
        state, event = adapter.rollback(state, LIFTING)
        assert (event.kind, event.direction, event.changes) == (ROLLED_BACK, LIFTING, expected)
        assert state.changes[LIFTING] == state.channels[LIFTING].target == expected
        assert state.channels[LOWERING] is other
    assert adapter.adapted(state).channels[LIFTING] == MODEL.channels[LIFTING]


@pytest.mark.parametrize("kind", [PROMOTED, MOVED, ROLLED_BACK])
@pytest.mark.parametrize(
    ("direction", "changes", "band", "message"),
    [
        (LIFTING, Changes(gain=700.0), 0.0, "has a gain of lifting beyond the largest change"),
        (LIFTING, Changes(gain=math.log(0.49)), 0.0, "has a gain of lifting beyond the largest change"),
        (LOWERING, Changes(dead_zone=-1.0), 0.0, "has a dead zone of lowering beyond the largest change"),
        (LOWERING, Changes(lag=2.0), 0.0, "has a lag of lowering beyond the largest change"),
        (LIFTING, Changes(), 710.0, "has a band of lifting beyond the largest change"),
        ("liftin", Changes(gain=0.1), 0.0, "expected changes of lifting or lowering, got 'liftin'"),
    ],
)
def test_a_log_beyond_the_bounds_is_not_gone_on_from(adapter, kind, direction, changes, band, message):
    with pytest.raises(InputError, match=message):
        adapter.resumed([Event(kind, 3.0, 2, direction, "", changes, (), {"band": band})])
    for gain in (float(np.log1p(-0.5)), float(np.log1p(0.5))):  # at the bounds
        event = Event(MOVED, 3.0, 2, LIFTING, "", Changes(gain=gain))
        assert adapter.resumed([event]).changes[LIFTING] == event.changes


@pytest.mark.parametrize("seed", [7, 11])
def test_a_promotion_that_loses_is_rolled_back_within_one_stroke(adapter, seed):
    strokes = machine.strokes(20, seed=seed, scatter=SCATTER, changed_at=8, gain=1.15)
    states, happened = learned(adapter, strokes)
    at = kinds(happened, PROMOTED)[0].stroke
    mode = strokes[at - 1].direction
    assert states[at - 1].changes[mode] == Changes()
    before, state = states[at - 1].changes, states[at]
    assert state.changes[mode] != before[mode]
    again = machine.strokes(3, seed=seed + 1, scatter=SCATTER)[DIRECTIONS.index(mode)]
    state, events = adapter.learn(state, again)
    (event,) = kinds([events], ROLLED_BACK)
    assert (event.direction, event.reason) == (mode, "the model before the last promotion is better")
    assert state.changes[mode] == before[mode]
    assert adapter.adapted(state).channels[mode] == MODEL.channels[mode]


def test_a_machine_that_changes_back_is_followed_back(adapter, run):
    where = {"first": len(CHANGED), "start": CHANGED[-1].displacement[-1]}
    later, _ = learned(adapter, machine.strokes(10, seed=9, scatter=SCATTER, **where), run[0][-1])
    assert gains(later[-1]) == pytest.approx([1.0, 1.0], rel=3 * SCATTER)


def log_of(make_record, strokes):
    commands, displacement = machine.stream(strokes)
    return make_record(displacement, *commands.T)


def test_standing_still_changes_nothing(make_record):
    still, noise = np.zeros(100_000), machine.NOISE * np.random.default_rng(0).standard_normal(100_000)
    moving = log_of(make_record, CHANGED[:4])
    standing = make_record(moving.displacement[-1] + noise, 0.5 * DEAD_ZONES[LIFTING] + still, still)
    first, second = (MODEL.adapt(records) for records in ([moving], [moving, standing]))
    assert first.events == second.events
    assert len(kinds([first.events], LEARNED)) == 4
    # Where the piston rested is not known from one log to the next.
    np.testing.assert_equal(asdict(replace(first.state, rested_at=math.nan)), asdict(second.state))


def test_logs_one_after_the_other_are_one_log(make_record):
    whole = MODEL.adapt([log_of(make_record, CHANGED[:12])])
    parts = MODEL.adapt([log_of(make_record, half) for half in (CHANGED[:6], CHANGED[6:12])])
    happened, expected = (
        [(event.kind, event.stroke, event.direction) for event in adapted.events]
        for adapted in (parts, whole)
    )
    assert happened == expected
    # Between two logs the rest before a stroke is that of its own log alone.
    for mode in DIRECTIONS:
        np.testing.assert_allclose(parts.state.changes[mode], whole.state.changes[mode], atol=1e-3)
    assert parts.events[-1].time_s == whole.events[-1].time_s


def test_a_change_log_is_gone_on_from_with_later_logs(make_record):
    before = MODEL.adapt([log_of(make_record, CHANGED[:14])])
    after = MODEL.adapt([log_of(make_record, CHANGED[14:])], earlier=before.events)
    assert after.events[: len(before.events)] == before.events
    assert after.state.strokes == len(CHANGED)
    assert [event.stroke for event in kinds([after.events], LEARNED)] == [*range(1, len(CHANGED) + 1)]


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(
    st.tuples(
        st.sampled_from(KINDS),
        st.floats(0, LONGEST_S),
        st.integers(0, MOST_STROKES),
        st.text(),
        st.text(),
    ),
    st.tuples(st.floats(-100, 100), st.floats(-1e8, 1e8), st.floats(-100, 100)),
    st.lists(st.integers(1, MOST_STROKES)),
    st.dictionaries(st.text(), FINITE),
)
def test_an_event_is_read_back_from_one_line_exactly(entry, changes, strokes, figures):
    event = Event(*entry, Changes(*changes), tuple(strokes), figures)
    line = event.to_json()
    assert len(line.splitlines()) == 1
    again = Event.from_json(line)
    assert again == event
    assert again.to_json() == line


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"parameters": ("dead_zone",)}, "expected 'gain' among them"),
        ({"parameters": ("gain", "leak")}, "parameters"),
        ({"window": 1}, "window"),
        ({"largest_gain": 1.0}, "largest_gain: expected a share below 1, got 1"),
        ({"change_per_stroke": 0.0}, "change_per_stroke"),
        ({"evidence": 1.0}, "evidence"),
    ],
)
def test_settings_that_are_not_possible_are_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        AdaptationSettings(**wrong)
