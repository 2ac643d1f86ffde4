"""The model beside the machine: in the units of the source, and never a free run over samples it lacks."""

import time

import numpy as np
import pytest

import handmade
import hitchid
from handmade import DEAD_ZONES, GAINS, STEP_S
from hitchid.errors import InputError, OutputError
from hitchid.hmi import monitor_loop
from hitchid.hmi.monitor_loop import AHEAD, FREE_RUN, HORIZON_S, MonitorLoop
from hitchid.live import Changes, Event, OnlineAdaptation, changed_model, read_events

MODEL = handmade.hitch()
LIFT, START = 0.5, 100.0
SPEED = GAINS["lifting"] * (LIFT - DEAD_ZONES["lifting"])  # mm/s
A_MM = ("A", "mm")


def samples(count, begin=0, displacement=None, command=LIFT):
    """Return samples of a lift that the model knows exactly, or at a given displacement."""
    time_s = STEP_S * np.arange(begin, begin + count)
    measured = START + SPEED * time_s if displacement is None else np.full(count, displacement)
    return np.column_stack([time_s, np.full(count, command), np.zeros(count), measured])


def predicted(loop, rows, kind=FREE_RUN):
    parts = [part for number, part in loop.advance(rows) if number == kind]
    return np.concatenate(parts) if parts else np.empty((0, 4))


@pytest.fixture
def loop():
    return MonitorLoop(MODEL, A_MM, STEP_S)


def test_the_free_run_is_the_model_s_without_a_band(loop):
    rows = samples(40)
    free_run = predicted(loop, rows)
    np.testing.assert_array_equal(free_run[:, 0], rows[:, 0])
    np.testing.assert_allclose(free_run[:, 1], rows[:, 3], rtol=1e-9)
    assert np.isnan(free_run[:, 2:]).all()


def test_the_prediction_ahead_is_for_a_second_later(loop):
    ahead = predicted(loop, samples(8), AHEAD)
    np.testing.assert_allclose(ahead[:, 0], np.array([3, 7]) * STEP_S + HORIZON_S)
    # Its last command is held, so that the lift goes on.
    np.testing.assert_allclose(ahead[:, 1], START + SPEED * ahead[:, 0], atol=SPEED * STEP_S * 1.01)


def test_other_units_and_blocks_of_the_source_give_the_same(loop):
    rows = samples(40)
    whole = predicted(loop, rows)
    in_cm = predicted(MonitorLoop(MODEL, ("mA", "cm"), STEP_S), rows * np.array([1.0, 1e3, 1e3, 0.1]))
    np.testing.assert_allclose(in_cm[:, 1], 0.1 * whole[:, 1], rtol=1e-9)
    again = MonitorLoop(MODEL, A_MM, STEP_S)
    pieces = [predicted(again, piece) for piece in np.split(rows, [1, 4, 9, 10, 25])]
    np.testing.assert_allclose(np.concatenate(pieces), whole, rtol=1e-12)


@pytest.mark.parametrize("before", [6, 8])
@pytest.mark.parametrize("at_once", [True, False])
def test_after_a_gap_the_free_run_starts_anew(loop, before, at_once):
    pieces = samples(before), samples(6, begin=100, displacement=30.0)
    calls = [np.concatenate(pieces)] if at_once else pieces
    free_run = np.concatenate([predicted(loop, rows) for rows in calls])
    whole = before // 4 * 4  # of blocks of four samples; those left over are not predicted
    np.testing.assert_allclose(free_run[:, 0], STEP_S * np.array([*range(whole), 100, 101, 102, 103]))
    assert free_run[whole, 1] == pytest.approx(30.0)


def test_a_restart_begins_anew_and_nothing_else_does(loop):
    assert len(predicted(loop, samples(8, displacement=np.nan))) == 0  # it waits for one
    predicted(loop, samples(8))
    free_run = predicted(loop, samples(8, begin=8, displacement=30.0))
    assert free_run[0, 1] == pytest.approx(START + 8 * STEP_S * SPEED)
    loop.restart()
    assert predicted(loop, samples(4, begin=16, displacement=30.0))[0, 1] == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("units", "step_s", "message"),
    [
        (A_MM, 2 * STEP_S, r"sampling time of 0\.01 s, the source of 0\.02 s; identify a model"),
        *((units, STEP_S, "unit|convert") for units in (("bar", "mm"), ("A", "V"), ("A", "nonsense"))),
    ],
)
def test_a_source_that_does_not_fit_the_model_is_refused(units, step_s, message):
    with pytest.raises(InputError, match=message):
        MonitorLoop(MODEL, units, step_s)


def test_a_band_lies_around_the_free_run_in_its_unit():
    model, rows = handmade.with_bands(MODEL, "lifting", "lowering"), samples(8)
    in_mm = predicted(MonitorLoop(model, A_MM, STEP_S), rows)
    assert np.all(in_mm[1:, 2] < in_mm[1:, 1])
    assert np.all(in_mm[1:, 3] > in_mm[1:, 1])
    in_cm = predicted(MonitorLoop(model, ("A", "cm"), STEP_S), rows * np.array([1.0, 1.0, 1.0, 0.1]))
    np.testing.assert_allclose(in_cm[:, 1:], 0.1 * in_mm[:, 1:], rtol=1e-6)


class FakeAdaptation(OnlineAdaptation):
    """Adaptation whose events are given; it learns nothing itself."""

    def __init__(self, model, *, log, earlier):
        del earlier
        self._identified, self._log = model, log
        self.fed, self.due, self.changes, self.back = [], [], {}, []

    @property
    def model(self):
        return changed_model(self._identified, self.changes)

    def feed(self, commands, displacement):
        self.fed.append(np.column_stack([commands, displacement]))
        events, self.due = self.due, []
        for event in events:
            self.changes[event.direction] = event.changes
            self._log(event)
        return tuple(events)

    def rollback(self, direction):
        self.back.append(direction)

    def finish(self):
        return ()


TWICE = Changes(gain=float(np.log(2.0)), dead_zone=0.01)


def event(kind, changes=TWICE, reason="proved better"):
    return Event(kind, 0.04, 1, "lifting", reason, changes)


@pytest.fixture
def adapted(monkeypatch, tmp_path):
    """Give a function that makes a loop whose adaptation is on, and the fake that adapts; end all of them."""
    loops, made = [], []

    def remembered(*given, **named):
        made.append(FakeAdaptation(*given, **named))
        return made[-1]

    def make(units=A_MM):
        monkeypatch.setattr(monitor_loop, "OnlineAdaptation", remembered)
        loop = MonitorLoop(MODEL, units, STEP_S)
        loops.append(loop)
        loop.adapt(tmp_path / "changes" / "a.jsonl")
        while loop.adaptation.model is None:
            loop.adaptation.start()
        return loop, made[-1]

    yield make
    for loop in loops:
        loop.adapt(None)  # which closes the change log


def steps_of(free_run):
    """Return the changes of a free run from sample to sample, over those of the identified lift."""
    return np.diff(free_run[:, 1]) / (SPEED * STEP_S)


def test_the_free_run_goes_on_with_what_was_learned(adapted):
    loop, fake = adapted()
    before = predicted(loop, samples(8))
    fake.due = [event("promoted", TWICE._replace(dead_zone=0.0))]
    between = predicted(loop, samples(4, begin=8))
    after = predicted(loop, samples(8, begin=12))
    np.testing.assert_allclose(steps_of(between), 1.0, rtol=1e-9)
    np.testing.assert_allclose(steps_of(after)[1:], 2.0, rtol=1e-9)
    assert before[-1, 1] < between[0, 1] < after[0, 1] < after[1, 1]
    loop.restart()  # which keeps the adapted model
    np.testing.assert_allclose(steps_of(predicted(loop, samples(8, begin=20))), 2.0, rtol=1e-9)
    loop.adapt(None)  # off means as identified
    np.testing.assert_allclose(steps_of(predicted(loop, samples(8, begin=28)))[1:], 1.0, rtol=1e-9)
    with pytest.raises(InputError, match="switch adaptation on first"):
        loop.adaptation.roll_back("lifting")


def test_it_learns_from_every_sample_and_lost_ones_are_missing(adapted):
    loop, fake = adapted(("mA", "cm"))
    rows = np.concatenate([samples(6), samples(5, begin=9)])
    loop.advance(rows * np.array([1.0, 1e3, 1e3, 0.1]))
    fed = np.concatenate(fake.fed)
    lost = np.full((3, 3), np.nan)
    np.testing.assert_allclose(fed, np.concatenate([rows[:6, 1:], lost, rows[6:, 1:]]), rtol=1e-12)


def test_the_page_hears_once_of_what_happened(adapted):
    loop, fake = adapted(("mA", "mm"))
    assert loop.news_of_adaptation()["state"] == "on"
    assert loop.news_of_adaptation() is None
    fake.due = [event("learned"), event("promoted"), event("moved")]
    loop.advance(samples(4, begin=100) * np.array([1.0, 1e3, 1e3, 1.0]))
    news = loop.news_of_adaptation()
    assert news["strokes"] == {"learned": 1, "refused": 0}
    assert news["directions"]["lifting"] == {
        "gain_percent": pytest.approx(100.0),
        "dead_zone": pytest.approx(10.0),  # mA
        "can_roll_back": True,
    }
    assert not news["directions"]["lowering"]["can_roll_back"]
    (shown,) = news["events"]
    assert (shown["kind"], shown["reason"], shown["at_s"]) == (
        "promoted",
        "proved better",
        pytest.approx(1.0),
    )
    assert loop.news_of_adaptation() is None
    # Refused strokes do not hide what was promoted.
    fake.due = [event("refused", Changes(), f"{number}") for number in range(9)]
    loop.advance(samples(4, begin=104) * np.array([1.0, 1e3, 1e3, 1.0]))
    reasons = {shown["reason"] for shown in loop.news_of_adaptation()["events"]}
    assert reasons == {"proved better", "7", "8"}


def test_an_adapted_model_is_saved_once(adapted, tmp_path):
    loop, fake = adapted()
    fake.due = [event("learned"), event("promoted")]
    loop.advance(samples(4))
    loop.adaptation.save(tmp_path / "saved")
    lifting = hitchid.load(tmp_path / "saved").channels["lifting"]
    assert float(lifting.benchmark.parameter_vector[0]) == pytest.approx(2 * GAINS["lifting"])
    assert lifting.dead_zone == pytest.approx(DEAD_ZONES["lifting"] + 0.01)
    with pytest.raises(OutputError, match="exists"):
        loop.adaptation.save(tmp_path / "saved")
    loop.adaptation.roll_back("lifting")
    assert fake.back == ["lifting"]
    loop.adapt(None)
    logged = read_events(tmp_path / "changes" / "a.jsonl")
    assert [event.kind for event in logged] == ["learned", "promoted"]
    again, fake = adapted()
    assert again.news_of_adaptation()["directions"]["lifting"]["can_roll_back"]
    fake.due = [event("rolled back", Changes())]
    again.advance(samples(4))
    assert not again.news_of_adaptation()["directions"]["lifting"]["can_roll_back"]


def test_a_model_that_cannot_be_adapted_is_used_as_identified(monkeypatch, tmp_path):
    def refuse(*_, **__):
        raise InputError("the model was adapted already")

    monkeypatch.setattr(monitor_loop, "OnlineAdaptation", refuse)
    loop = MonitorLoop(MODEL, A_MM, STEP_S)
    (tmp_path / "notes.jsonl").write_text("nonsense\n")
    with pytest.raises(InputError, match="line 1: is no entry of a change log"):
        loop.adapt(tmp_path / "notes.jsonl")
    assert loop.news_of_adaptation() is None
    loop.adapt(tmp_path / "a.jsonl")
    assert loop.news_of_adaptation()["state"] == "starting"
    end_s = time.monotonic() + 10
    while (news := loop.news_of_adaptation()) is None:
        assert time.monotonic() < end_s
        assert len(predicted(loop, samples(4))) == 4
    assert (news["state"], news["reason"]) == ("off", "the model was adapted already")
