"""The model beside the machine: in the units of the source, and never a free run over samples it lacks."""

import time

import numpy as np
import pytest

import handmade
import hitchid
from handmade import DEAD_ZONES, GAINS, STEP_S
from hitchid.errors import InputError, OutputError
from hitchid.hmi import model_beside
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
    found = [part for number, part in loop.advance(rows) if number == kind]
    return np.concatenate(found) if found else np.empty((0, 4))


@pytest.fixture
def loop():
    return MonitorLoop(MODEL, A_MM, STEP_S)


def test_the_free_run_is_the_model_s_and_nan_where_it_has_no_band(loop):
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


def test_other_units_of_the_source_give_the_same_in_those_units(loop):
    rows = samples(40)
    other = MonitorLoop(MODEL, ("mA", "cm"), STEP_S)
    found = predicted(other, rows * np.array([1.0, 1e3, 1e3, 0.1]))
    np.testing.assert_allclose(found[:, 1], 0.1 * predicted(loop, rows)[:, 1], rtol=1e-9)


def test_blocks_of_any_length_give_the_same(loop):
    rows = samples(40)
    pieces = np.split(rows, [1, 4, 9, 10, 25])
    found = np.concatenate([predicted(loop, piece) for piece in pieces])
    whole = predicted(MonitorLoop(MODEL, A_MM, STEP_S), rows)
    np.testing.assert_allclose(found, whole, rtol=1e-12)


@pytest.mark.parametrize("before", [8, 10])
def test_after_a_gap_the_free_run_starts_anew_at_the_measurement(loop, before):
    predicted(loop, samples(before))
    again = predicted(loop, samples(8, begin=before + 50, displacement=30.0))
    assert again[0, 0] == pytest.approx(STEP_S * (before + 50))
    assert again[0, 1] == pytest.approx(30.0)


def test_a_gap_inside_a_block_is_one_too(loop):
    rows = np.concatenate([samples(6), samples(6, begin=100, displacement=30.0)])
    found = predicted(loop, rows)
    np.testing.assert_allclose(found[:, 0], STEP_S * np.array([0, 1, 2, 3, 100, 101, 102, 103]))
    assert found[4, 1] == pytest.approx(30.0)


def test_no_gap_no_restart(loop):
    predicted(loop, samples(8))
    found = predicted(loop, samples(8, begin=8, displacement=30.0))
    assert found[0, 1] == pytest.approx(START + 8 * STEP_S * SPEED)


def test_a_restart_begins_at_the_present_displacement(loop):
    predicted(loop, samples(8))
    loop.restart()
    assert predicted(loop, samples(4, begin=8, displacement=30.0))[0, 1] == pytest.approx(30.0)


def test_it_waits_for_a_displacement(loop):
    assert len(predicted(loop, samples(8, displacement=np.nan))) == 0
    assert len(predicted(loop, samples(4, begin=8))) == 4


def test_a_sampling_time_that_is_not_the_model_s_is_refused():
    with pytest.raises(
        InputError, match=r"sampling time of 0\.01 s, the source of 0\.02 s; identify a model"
    ):
        MonitorLoop(MODEL, A_MM, 2 * STEP_S)


@pytest.mark.parametrize("units", [("bar", "mm"), ("A", "V"), ("A", "nonsense")])
def test_units_that_cannot_be_converted_are_refused(units):
    with pytest.raises(InputError):
        MonitorLoop(MODEL, units, STEP_S)


def test_a_band_lies_around_the_free_run_and_scales_with_the_unit():
    model = handmade.with_bands(MODEL, "lifting", "lowering")
    in_mm, in_cm = MonitorLoop(model, A_MM, STEP_S), MonitorLoop(model, ("A", "cm"), STEP_S)
    rows = samples(8)
    found = predicted(in_mm, rows)
    assert np.all(found[1:, 2] < found[1:, 1])
    assert np.all(found[1:, 3] > found[1:, 1])
    scaled = predicted(in_cm, rows * np.array([1.0, 1.0, 1.0, 0.1]))
    np.testing.assert_allclose(scaled[:, 1:], 0.1 * found[:, 1:], rtol=1e-6)


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
    """Return a function that makes a loop whose adaptation is on, and the fake that adapts."""
    made = []

    def remembered(*given, **named):
        made.append(FakeAdaptation(*given, **named))
        return made[-1]

    def make(units=A_MM):
        monkeypatch.setattr(model_beside, "OnlineAdaptation", remembered)
        loop = MonitorLoop(MODEL, units, STEP_S)
        loop.adapt(tmp_path / "changes" / "a.jsonl")
        while loop.adaptation.model is None:
            loop.adaptation.start()
        return loop, made[-1]

    return make


def test_the_free_run_goes_on_with_what_was_learned_from_where_it_was(adapted):
    loop, fake = adapted()
    before = predicted(loop, samples(8))
    fake.due = [event("promoted", TWICE._replace(dead_zone=0.0))]
    between = predicted(loop, samples(4, begin=8))
    after = predicted(loop, samples(8, begin=12))
    np.testing.assert_allclose(np.diff(between[:, 1]), SPEED * STEP_S, rtol=1e-9)
    np.testing.assert_allclose(np.diff(after[1:, 1]), 2 * SPEED * STEP_S, rtol=1e-9)
    assert before[-1, 1] < between[0, 1] < after[0, 1] < after[1, 1]


def test_off_means_as_identified(adapted):
    loop, fake = adapted()
    predicted(loop, samples(8))
    fake.due = [event("promoted")]
    predicted(loop, samples(4, begin=8))
    loop.adapt(None)
    found = predicted(loop, samples(8, begin=12))
    np.testing.assert_allclose(np.diff(found[1:, 1]), SPEED * STEP_S, rtol=1e-9)
    with pytest.raises(InputError, match="switch adaptation on first"):
        loop.adaptation.roll_back("lifting")


def test_a_restart_keeps_the_adapted_model(adapted):
    loop, fake = adapted()
    fake.due = [event("promoted", TWICE._replace(dead_zone=0.0))]
    predicted(loop, samples(8))
    loop.restart()
    found = predicted(loop, samples(8, begin=8))
    np.testing.assert_allclose(np.diff(found[:, 1]), 2 * SPEED * STEP_S, rtol=1e-9)


def test_it_learns_from_every_sample_in_the_model_s_units_and_lost_ones_are_missing(adapted):
    loop, fake = adapted(("mA", "cm"))
    rows = np.concatenate([samples(6), samples(5, begin=9)])
    loop.advance(rows * np.array([1.0, 1e3, 1e3, 0.1]))
    fed = np.concatenate(fake.fed)
    lost = np.full((3, 3), np.nan)
    np.testing.assert_allclose(fed, np.concatenate([rows[:6, 1:], lost, rows[6:, 1:]]), rtol=1e-12)


def test_the_page_is_told_once_what_is_in_use_and_what_happened(adapted):
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
    (told,) = news["events"]
    assert (told["kind"], told["reason"], told["at_s"]) == ("promoted", "proved better", pytest.approx(1.0))
    assert loop.news_of_adaptation() is None


def test_refused_strokes_do_not_hide_what_was_promoted(adapted):
    loop, fake = adapted()
    fake.due = [event("promoted"), *(event("refused", Changes(), f"{number}") for number in range(9))]
    loop.advance(samples(4))
    assert {each["reason"] for each in loop.news_of_adaptation()["events"]} == {"proved better", "7", "8"}


def test_the_change_log_holds_every_event_and_is_gone_on_from(adapted, tmp_path):
    loop, fake = adapted()
    fake.due = [event("learned"), event("promoted")]
    loop.advance(samples(4))
    loop.adaptation.roll_back("lifting")
    assert fake.back == ["lifting"]
    loop.adapt(None)
    assert [each.kind for each in read_events(tmp_path / "changes" / "a.jsonl")] == ["learned", "promoted"]
    again, fake = adapted()
    assert again.news_of_adaptation()["directions"]["lifting"]["can_roll_back"]
    fake.due = [event("rolled back", Changes())]
    again.advance(samples(4))
    assert not again.news_of_adaptation()["directions"]["lifting"]["can_roll_back"]


def test_an_adapted_model_is_saved_once(adapted, tmp_path):
    loop, fake = adapted()
    fake.due = [event("promoted")]
    loop.advance(samples(4))
    loop.adaptation.save(tmp_path / "saved")
    lifting = hitchid.load(tmp_path / "saved").channels["lifting"]
    assert float(lifting.benchmark.parameter_vector[0]) == pytest.approx(2 * GAINS["lifting"])
    assert lifting.dead_zone == pytest.approx(DEAD_ZONES["lifting"] + 0.01)
    with pytest.raises(OutputError, match="exists"):
        loop.adaptation.save(tmp_path / "saved")


def test_a_model_that_cannot_be_adapted_is_used_as_identified_and_the_page_is_told_why(monkeypatch, tmp_path):
    def refuse(*_, **__):
        raise InputError("the model was adapted already")

    monkeypatch.setattr(model_beside, "OnlineAdaptation", refuse)
    loop = MonitorLoop(MODEL, A_MM, STEP_S)
    loop.adapt(tmp_path / "a.jsonl")
    assert loop.news_of_adaptation()["state"] == "starting"
    end_s = time.monotonic() + 10
    while (news := loop.news_of_adaptation()) is None:
        assert time.monotonic() < end_s
        assert len(predicted(loop, samples(4))) == 4
    assert (news["state"], news["reason"]) == ("off", "the model was adapted already")


def test_a_log_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.jsonl").write_text("nonsense\n")
    loop = MonitorLoop(MODEL, A_MM, STEP_S)
    with pytest.raises(InputError, match="line 1: is no entry of a change log"):
        loop.adapt(tmp_path / "a.jsonl")
    assert loop.news_of_adaptation() is None
