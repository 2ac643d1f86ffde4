"""Adaptation beside a running model: what it learns is what logs teach, and it never stops the model."""

import json
import math

import numpy as np
import pytest

import handmade
import machine
from hitchid.errors import InputError
from hitchid.live import AdaptationSettings, Adapter, Changes, Event, OnlineAdaptation, changed_model
from hitchid.live.adaptation_process import stroke_message, stroke_of
from hitchid.live.events import FAULT, PROMOTED, ROLLED_BACK
from hitchid.live.live import AGREEING, FIELDS, Live
from hitchid.live.parameters import numbers_of_models
from hitchid.logs.record import LIFTING, LOWERING
from machine import DIRECTIONS, STEP_S

MODEL = handmade.with_bands(machine.MODEL, *DIRECTIONS)
SCHEDULED = handmade.hitch_of(
    *(handmade.channel(mode, "integrator-first-order", shape=True) for mode in DIRECTIONS)
)
STROKES = machine.strokes(10, seed=7, scatter=0.015, changed_at=2, samples=60, gain=1.15)
COMMANDS, DISPLACEMENT = machine.stream(STROKES)


@pytest.fixture(scope="module")
def replayed(make_record):
    """Return what the same stream teaches as a log."""
    return MODEL.adapt([make_record(DISPLACEMENT, *COMMANDS.T)])


@pytest.fixture
def in_time(monkeypatch):
    """Let learning take less than half a second, as on a machine with nothing beside it."""
    monkeypatch.setattr(OnlineAdaptation, "_is_answered", lambda self, _: self._connection.poll(None))


def as_json(events):
    return [event.to_json() for event in events]


@pytest.mark.usefixtures("in_time")
def test_a_stream_teaches_what_a_log_does_bit_for_bit(replayed):
    logged, events = [], []
    online = OnlineAdaptation(MODEL, log=logged.append)
    for start in range(0, len(DISPLACEMENT), 70):
        block = slice(start, start + 70)
        events += online.feed(COMMANDS[block], DISPLACEMENT[block])
    online.rollback(LIFTING)
    events += online.finish()
    state, event = Adapter(MODEL, AdaptationSettings()).rollback(replayed.state, LIFTING)
    assert as_json(events) == as_json((*replayed.events, event))
    assert logged == events
    assert {PROMOTED, ROLLED_BACK} <= {event.kind for event in events}
    assert online.changes == state.changes
    assert online.model.provenance == changed_model(MODEL, state.changes, state.band_factors).provenance
    assert state.changes[LOWERING] != Changes()


def line(number):
    """Return one sample of the stream as a line."""
    values = number * STEP_S, *COMMANDS[number], DISPLACEMENT[number]
    return json.dumps(dict(zip(FIELDS, values, strict=True)))


@pytest.mark.usefixtures("in_time")
def test_a_running_model_follows_until_learning_ends(replayed):
    events = []
    adaptation = OnlineAdaptation(MODEL, log=events.append)
    live, frozen = Live(MODEL, adaptation=adaptation), Live(MODEL)
    learned_from = 8 * len(STROKES[0].displacement)
    for number in range(learned_from):
        answer = live.process(line(number))
        if number % 2:
            live.learn()
        assert math.isfinite(answer.displacement)
        if not adaptation.changes[LIFTING].gain and not adaptation.changes[LOWERING].gain:
            # The same numbers, in a program of their own.
            expected = frozen.process(line(number))
            assert (answer.mode, answer.time_s) == (expected.mode, expected.time_s)
            assert answer.displacement == pytest.approx(expected.displacement, rel=1e-12)
    assert as_json(events) == as_json(replayed.events[: len(events)])
    assert PROMOTED in {event.kind for event in events}
    changes = dict(adaptation.changes)
    assert changes[LIFTING].gain == pytest.approx(math.log(1.15), abs=0.045)

    adaptation._process.kill()
    adaptation._process.wait()
    before = len(events)
    answers = [live.process(line(number)) for number in range(learned_from, len(DISPLACEMENT))]
    assert all(math.isfinite(answer.displacement) for answer in answers)
    # The answer to the last stroke may have been on its way.
    reason = "the process that learns has ended; the model stays as it is"
    assert [event.reason for event in events[before:] if event.kind == FAULT] == [reason]
    assert sum(f"fault: {reason}" in answer.flags for answer in answers) == 1
    assert adaptation.changes == changes
    assert adaptation.finish() == ()


@pytest.mark.long
def test_adapted_parameters_stay_after_a_restart(monkeypatch):
    """The state of a model with covariates has the parameters at its load."""
    model, load = SCHEDULED, {"pressure": 150.0}
    changed = changed_model(model, {LIFTING: Changes(0.2), LOWERING: Changes(-0.2)})
    adaptation = OnlineAdaptation(model, load=load)
    monkeypatch.setattr(adaptation, "feed", lambda *_: ())
    adaptation.numbers = np.asarray(numbers_of_models(changed))
    live = Live(model, initial=100.0, load=load, adaptation=adaptation)
    expected = Live(changed, initial=100.0, load=load)
    # New numbers, which are the same, come with sample 39; another sample then takes its place. After the
    # second part is a gap longer than is simulated.
    parts = np.arange(40.0), 39.2 + np.arange(40.0), 5000.0 + np.arange(40.0)
    for number, time_s in enumerate(np.concatenate(parts) * model.step_s):
        sample = {"time_s": time_s, "lifting_command": 0.6, "lowering_command": 0.0}
        line = json.dumps({**sample, "displacement": 100.0} if number % 40 < AGREEING else sample)
        displacement, wanted = live.process(line).displacement, expected.process(line).displacement
        assert displacement == pytest.approx(wanted, rel=1e-9), number
        if number == 39:
            adaptation.numbers = adaptation.numbers.copy()
            live.learn()
    assert wanted > 100.1  # it moves
    adaptation.finish()


@pytest.mark.long
def test_an_output_does_not_wait_for_what_its_sample_teaches(monkeypatch):
    adaptation, fed = OnlineAdaptation(MODEL), []
    event = Event(PROMOTED, 0.0, 0, LIFTING, "the gain", Changes())

    def feed(_, displacement):
        fed.append(displacement.tolist())
        return (event,)

    monkeypatch.setattr(adaptation, "feed", feed)
    live = Live(MODEL, adaptation=adaptation)
    first = live.process(line(0))
    assert fed == []
    live.learn()
    live.learn()
    assert fed == [[DISPLACEMENT[0]]]
    second, third = live.process(line(1)), live.process(line(2))
    assert fed == [[DISPLACEMENT[0]], [DISPLACEMENT[1]]]
    assert [event.sentence in answer.flags for answer in (first, second, third)] == [False, True, True]
    adaptation.finish()


def test_a_model_that_follows_predicts_better(replayed):
    late = slice(8 * len(STROKES[0].displacement), None)
    commands, measured = COMMANDS[late], DISPLACEMENT[late]
    errors = [
        np.std(model.simulate(commands, step_s=STEP_S, initial=float(measured[0])).displacement - measured)
        for model in (replayed.model, MODEL)
    ]
    assert errors[0] < 0.5 * errors[1]


def test_a_stroke_is_sent_bit_for_bit():
    stroke = STROKES[3]._replace(displacement=np.where(STROKES[3].commands[:, 1] > 0, np.nan, -0.1))
    again = stroke_of(stroke_message(stroke))
    assert again[:3] == stroke[:3]
    np.testing.assert_array_equal(again.commands, stroke.commands)
    np.testing.assert_array_equal(again.displacement, stroke.displacement)
    with pytest.raises(InputError, match=r"^model: expected one as identified, got one that was adapted"):
        OnlineAdaptation(changed_model(MODEL, {LIFTING: Changes(0.1)}))
