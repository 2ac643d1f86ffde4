"""The change log as a file that is gone on from, also after a cut line, and the trends that it shows."""

import contextlib
import json
import math
import os
from dataclasses import replace

import numpy as np
import pytest

import handmade
from hitchid.errors import InputError, OutputError
from hitchid.live import ChangeLog, Changes, Event, read_events
from hitchid.live.change_log import STROKES_APART, trends
from hitchid.live.events import LEARNED, REFUSED
from hitchid.logs.record import LIFTING

MODEL, OTHER, UNSAVED = (
    replace(model, provenance=replace(model.provenance, digest=digest))
    for model, digest in ((handmade.hitch(), "a" * 64), (handmade.hitch(), "b" * 64), (handmade.hitch(), ""))
)


def event(number):
    return Event("learned", 0.1 * number, number, "lifting", "", Changes(gain=0.1 * number))


def test_the_next_log_goes_on_from_what_was_written(tmp_path):
    path = tmp_path / "new" / "changes.jsonl"
    log = ChangeLog(path, MODEL)
    assert log.earlier == ()
    log.write(event(1))
    assert read_events(path) == (event(1),)
    log.close()
    again = ChangeLog(path, MODEL)
    assert again.earlier == (event(1),)
    again.write(event(2))
    assert read_events(path) == (event(1), event(2))


@pytest.mark.parametrize("left", [1, 20, -1])
def test_a_line_that_was_cut_spoils_no_later_one(tmp_path, left):
    path = tmp_path / "changes.jsonl"
    path.write_text(f"{event(1).to_json()}\n{event(2).to_json()[:left]}")
    log = ChangeLog(path, MODEL)
    assert log.earlier == read_events(path) == (event(1),)
    log.write(event(3))
    assert read_events(path) == (event(1), event(3))


def test_what_is_no_change_log_is_refused_and_stays(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nonsense\n")
    with pytest.raises(InputError, match="line 1: is no entry of a change log"):
        ChangeLog(path, MODEL)
    assert path.read_text() == "nonsense\n"
    with pytest.raises(OutputError, match=r"notes\.txt/changes\.jsonl: cannot be written"):
        ChangeLog(path / "changes.jsonl", MODEL)
    with pytest.raises(InputError, match="cannot be read"):
        read_events(tmp_path / "missing")
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match=r"huge, line 1: .* longer than 65536 bytes"):  # before it is read
        ChangeLog(tmp_path / "huge", MODEL)


def test_a_log_is_gone_on_from_with_its_model(tmp_path):
    path = tmp_path / "changes.jsonl"
    log = ChangeLog(path, MODEL)
    log.write(event(1))
    log.close()
    written = path.read_text()
    assert written == f'{{"model": "{"a" * 64}"}}\n{event(1).to_json()}\n'
    message = "another model: got digest aaaaaaaaaaaa, expected bbbbbbbbbbbb; give"
    with pytest.raises(InputError, match=message):
        ChangeLog(path, OTHER)
    assert path.read_text() == written
    for model in (UNSAVED, MODEL):
        log = ChangeLog(path, model)
        assert log.earlier == (event(1),)
        log.close()
    assert read_events(path) == (event(1),)


def test_a_log_without_a_model_is_gone_on_from(tmp_path):
    path = tmp_path / "changes.jsonl"
    path.write_text(f"{event(1).to_json()}\n")
    log = ChangeLog(path, MODEL)
    log.write(event(2))
    assert read_events(path, OTHER) == (event(1), event(2))


@pytest.mark.parametrize("left", [0, 1, 30])
def test_a_first_line_that_was_cut_is_written_again(tmp_path, left):
    path = tmp_path / "changes.jsonl"
    path.write_text(f'{{"model": "{"b" * 64}"}}'[:left])
    log = ChangeLog(path, MODEL)
    log.write(event(1))
    assert path.read_text() == f'{{"model": "{"a" * 64}"}}\n{event(1).to_json()}\n'


def test_where_nothing_happened_what_was_there_is_left(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "empty.jsonl").touch()
    for path in ("new/folder/changes.jsonl", "empty.jsonl", "mine/changes.jsonl"):
        ChangeLog(tmp_path / path, MODEL).close()
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == ["empty.jsonl", "mine"]


def test_a_whole_last_line_counts_though_it_has_no_end(tmp_path):
    path = tmp_path / "changes.jsonl"
    path.write_text(f"{event(1).to_json()}\n\n{event(2).to_json()}")
    log = ChangeLog(path, MODEL)
    assert log.earlier == (event(1), event(2))
    log.write(event(3))
    assert read_events(path) == (event(1), event(2), event(3))


# --- one writer, and a disk that is full --------------------------------------------------------------------


@pytest.mark.skipif(os.name == "nt", reason="there are no such locks and files")
def test_a_second_writer_or_a_pipe_is_refused(tmp_path):
    path = tmp_path / "changes.jsonl"
    first = ChangeLog(path, MODEL)
    with pytest.raises(OutputError, match=r"changes\.jsonl: another process writes this change log"):
        ChangeLog(path, MODEL)
    first.write(event(1))
    first.close()
    second = ChangeLog(path, MODEL)
    assert second.earlier == (event(1),)
    second.close()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: cannot be a change log: expected a file"):
        ChangeLog(tmp_path / "pipe", MODEL)


@pytest.mark.skipif(os.name == "nt", reason="there are no such limits")
@pytest.mark.parametrize("room", [0, 50, 1000])
def test_a_full_disk_is_told_and_leaves_whole_lines(tmp_path, room):
    """A limit on the size of files fails as a full disk does: a line is written in part, or not at all."""
    import resource

    path = tmp_path / "changes.jsonl"
    log, before = ChangeLog(path, MODEL), resource.getrlimit(resource.RLIMIT_FSIZE)
    written = []
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        for number in range(1, 1 + room // 200):
            log.write(event(number))
            written.append(event(number))
        with pytest.raises(OutputError, match=r"changes\.jsonl: cannot be written: "):
            log.write(event(9))
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.exists() == bool(written) == (room == 1000)
    assert not written or read_events(path) == tuple(written)


# --- damaged logs -------------------------------------------------------------------------------------------


def entry(gain=None, **others):
    """Return an entry as it is not written: with the text of another gain, or with other values."""
    content = {**json.loads(event(1).to_json()), **others}
    if gain is None:
        return json.dumps(content)
    changes = {"gain": "x", "dead_zone": 0.0, "lag": 0.0}
    return json.dumps({**content, "changes": changes}).replace('"x"', gain)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("[" * 100_000, "longer than 65536 bytes|recursion"),
        ("[" * 1000, "recursion"),
        ("\0" * 1000, "JSON"),
        (entry(kind="larned"), "kind: expected one of learned, refused"),
        (entry(time_s=-1.0), "time_s: .*greater than or equal to 0"),
        (entry(time_s=1e300), "time_s: .*less than or equal to"),
        (entry(time_s=None), "time_s: .*number"),
        (entry(stroke=1.5), "stroke: .*integer"),
        (entry(stroke=10**40), "stroke: "),
        (entry(strokes={}), "strokes: "),
        (entry(figures=[]), "figures: "),
        (entry(figures={"band": "wide"}), r"figures\.band: .*number"),
        (entry(changes={"gain": 0.1, "dead_zone": 0.0}), "changes: .*expected gain, dead_zone, lag"),
        (entry(gain="true"), r"changes\.gain: .*number"),
        (entry(changes={"gain": 0.1, "dead_zone": 0.0, "lag": 0.0, "more": 1}), "changes: .*expected gain"),
        (entry(gain="NaN"), "finite|JSON"),
        (entry(gain="1e999"), "finite"),
        (entry(gain="9" * 5000), "range"),
        (entry(more=1), "more: "),
        ('{"model": 5}', "kind: Field required"),
    ],
    ids=range(20),
)
def test_a_damaged_entry_is_refused_with_line_and_reason(tmp_path, line, reason):
    path = tmp_path / "changes.jsonl"
    path.write_text(f'{{"model": "{"a" * 64}"}}\n{line}\n')
    with pytest.raises(InputError, match=f"line 2: is no entry of a change log: .*({reason})"):
        ChangeLog(path, MODEL)


def test_a_log_of_two_writers_is_refused(tmp_path):
    path = tmp_path / "changes.jsonl"
    path.write_text("".join(f"{event(number).to_json()}\n" for number in (1, 3, 2)))
    with pytest.raises(InputError, match=r"an entry of 0\.2 s follows one of 0\.3 s; use a new file"):
        read_events(path)


def test_whatever_bytes_are_changed_a_log_is_read_or_refused(tmp_path):
    rng, path = np.random.default_rng(5), tmp_path / "changes.jsonl"
    log = ChangeLog(path, MODEL)
    for number in range(1, 6):
        log.write(event(number))
    log.close()
    content, edits = path.read_bytes(), [b"", b"0", b"e9", b"[", b'"', b"\xff", b"\n"]
    for _ in range(300):
        edited = bytearray(content)
        for at in rng.integers(len(edited), size=rng.integers(1, 4)):
            edited[at : at + rng.integers(3)] = rng.choice(edits)
        path.write_bytes(edited)
        with contextlib.suppress(InputError):
            read_events(path, MODEL)


# --- trends -------------------------------------------------------------------------------------------------

LIMITS = {"gain": 0.4, "dead_zone": 0.15}
DEVIATION = {"gain": 0.01, "dead_zone": 0.003}


def change_log(per_hour, hours, seed, strokes=400):
    """Return the events of a machine whose gain changes at a rate, with noise of the stated deviation."""
    rng, events = np.random.default_rng(seed), []
    for number in range(1, strokes + 1):
        time_h = hours * number / strokes
        figures = {
            "gain": per_hour * time_h + DEVIATION["gain"] * rng.standard_normal(),
            "dead_zone": DEVIATION["dead_zone"] * rng.standard_normal(),
            **{f"{name}_deviation": value for name, value in DEVIATION.items()},
        }
        events.append(Event(LEARNED, 3600 * time_h, number, LIFTING, "", Changes(), (), figures))
    return events


def test_intervals_hold_the_slope_and_significance_is_rare_without_one():
    all_trends = [trends(change_log(-0.01, 10.0, seed), LIMITS) for seed in range(200)]
    inside = np.mean([gain.interval[0] <= -0.01 <= gain.interval[1] for gain, _ in all_trends])
    # Binomial with 200 draws: four standard deviations of 0.95 are 0.06; a variance held at one widens it.
    assert inside >= 0.95 - 0.06
    assert np.mean([dead_zone.significant for _, dead_zone in all_trends]) <= 0.05 + 0.06


def test_a_limit_is_reached_when_the_line_reaches_it():
    gain, dead_zone = trends(change_log(-0.02, 10.0, 1), LIMITS)
    earliest, expected, latest = gain.limit_after_h
    assert gain.significant
    assert not dead_zone.significant
    # From −0.2 to −0.4 at −0.02 an hour; the slope is known to a few percent.
    assert expected == pytest.approx(10.0, rel=0.15)
    assert earliest <= expected <= latest


def test_a_parameter_that_stays_or_few_strokes_have_no_limit():
    still = {"gain": 0.0, "dead_zone": 0.0}
    events = [replace(event, figures={**event.figures, **still}) for event in change_log(0.0, 10.0, 1)]
    gain, _ = trends(events, LIMITS)
    assert math.isinf(gain.limit_after_h[2])
    assert not gain.significant
    assert trends(change_log(0.0, 1.0, 1, strokes=4 * STROKES_APART), LIMITS) == ()


def test_a_leak_is_a_trend_with_the_given_limit():
    # From 0.01 mm/s on, 0.002 mm/s more each hour, each known to 0.001 mm/s; refused strokes show it, too.
    rng, events = np.random.default_rng(4), []
    for number in range(1, 101):
        time_h = 0.1 * number
        leak = -0.01 - 0.002 * time_h + 0.001 * rng.standard_normal()
        figures = {"leak": leak, "leak_deviation": 0.001}
        events.append(Event(REFUSED, 3600 * time_h, number, LIFTING, "", Changes(), (), figures))
    (limited,) = trends(events, {**LIMITS, "leak": 0.05})
    assert (limited.direction, limited.parameter) == ("", "leak")
    # The standard error of the slope is 0.001 over the root of the spread of the times, 29 h.
    assert limited.per_hour == pytest.approx(-0.002, abs=4 * 0.001 / 29)
    assert limited.limit_after_h[1] == pytest.approx((0.05 - 0.03) / 0.002, rel=0.1)
    (unlimited,) = trends(events, LIMITS)
    assert np.isinf(unlimited.limit_after_h).all()


@pytest.mark.parametrize("figures", [{}, {"gain": 0.1}, {"gain": 0.1, "gain_deviation": 0.0}])
def test_an_entry_that_lacks_a_figure_is_named(figures):
    events = change_log(0.0, 1.0, seed=1, strokes=60)
    events[-1] = Event(LEARNED, 3600.0, 60, LIFTING, "", Changes(), (), figures)
    with pytest.raises(InputError, match="events: 'learned' at 3600 s: expected the figures gain"):
        trends(events, LIMITS)
