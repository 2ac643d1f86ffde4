"""The change log as a file: every event at once, and on from where it was, also after a cut line."""

import contextlib
import json
import os
from dataclasses import replace

import numpy as np
import pytest

import handmade
from hitchid.errors import InputError, OutputError
from hitchid.live import ChangeLog, Changes, Event, read_events

MODEL, OTHER, UNSAVED = (
    replace(model, provenance=replace(model.provenance, digest=digest))
    for model, digest in ((handmade.hitch(), "a" * 64), (handmade.hitch(), "b" * 64), (handmade.hitch(), ""))
)


def event(number):
    return Event("learned", 0.1 * number, number, "lifting", "", Changes(gain=0.1 * number))


def test_events_are_in_the_file_at_once_and_the_next_log_goes_on_from_them(tmp_path):
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
def test_a_line_that_was_cut_is_left_out_and_spoils_no_later_one(tmp_path, left):
    path = tmp_path / "changes.jsonl"
    path.write_text(f"{event(1).to_json()}\n{event(2).to_json()[:left]}")
    log = ChangeLog(path, MODEL)
    assert log.earlier == (event(1),)
    log.write(event(3))
    assert read_events(path) == (event(1), event(3))


def test_a_file_that_is_no_change_log_is_refused_and_stays(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nonsense\n")
    with pytest.raises(InputError, match="line 1: is no entry of a change log"):
        ChangeLog(path, MODEL)
    assert path.read_text() == "nonsense\n"


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/changes\.jsonl: cannot be written"):
        ChangeLog(tmp_path / "file" / "changes.jsonl", MODEL)


def test_a_log_is_gone_on_from_with_its_own_model_alone(tmp_path):
    path = tmp_path / "changes.jsonl"
    log = ChangeLog(path, MODEL)
    log.write(event(1))
    log.close()
    written = path.read_text()
    assert written == f'{{"model": "{"a" * 64}"}}\n{event(1).to_json()}\n'
    with pytest.raises(
        InputError, match="another model: got digest aaaaaaaaaaaa, expected bbbbbbbbbbbb; give"
    ):
        ChangeLog(path, OTHER)
    assert path.read_text() == written
    for model in (UNSAVED, MODEL):
        log = ChangeLog(path, model)
        assert log.earlier == (event(1),)
        log.close()
    assert read_events(path) == (event(1),)


def test_a_log_of_an_earlier_version_has_no_model_and_is_gone_on_from(tmp_path):
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


def test_where_nothing_happened_nothing_is_left(tmp_path):
    ChangeLog(tmp_path / "new" / "folder" / "changes.jsonl", MODEL).close()
    assert list(tmp_path.iterdir()) == []


def test_what_was_there_before_is_left_where_nothing_happened(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "empty.jsonl").touch()
    ChangeLog(tmp_path / "empty.jsonl", MODEL).close()
    ChangeLog(tmp_path / "mine" / "changes.jsonl", MODEL).close()
    assert sorted(each.name for each in tmp_path.iterdir()) == ["empty.jsonl", "mine"]


def test_a_last_line_that_is_whole_counts_and_stays_though_it_has_no_end(tmp_path):
    path = tmp_path / "changes.jsonl"
    path.write_text(f"{event(1).to_json()}\n\n{event(2).to_json()}")
    log = ChangeLog(path, MODEL)
    assert log.earlier == (event(1), event(2))
    log.write(event(3))
    assert read_events(path) == (event(1), event(2), event(3))


# --- one writer, and a disk that is full --------------------------------------------------------------------


@pytest.mark.skipif(os.name == "nt", reason="there is no such lock")
def test_a_second_writer_is_refused_until_the_first_is_gone(tmp_path):
    path = tmp_path / "changes.jsonl"
    first = ChangeLog(path, MODEL)
    with pytest.raises(OutputError, match=r"changes\.jsonl: another process writes this change log"):
        ChangeLog(path, MODEL)
    first.write(event(1))
    first.close()
    second = ChangeLog(path, MODEL)
    assert second.earlier == (event(1),)
    second.close()


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


def entry(**others):
    return json.dumps({**json.loads(event(1).to_json()), **others})


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
        (entry(changes={"gain": True, "dead_zone": 0.0, "lag": 0.0}), r"changes\.gain: .*number"),
        (entry(changes={"gain": 0.1, "dead_zone": 0.0, "lag": 0.0, "more": 1}), "changes: .*expected gain"),
        (entry(changes={"gain": "x", "dead_zone": 0.0, "lag": 0.0}).replace('"x"', "NaN"), "finite|JSON"),
        (entry(changes={"gain": "x", "dead_zone": 0.0, "lag": 0.0}).replace('"x"', "1e999"), "finite"),
        (entry(changes={"gain": "x", "dead_zone": 0.0, "lag": 0.0}).replace('"x"', "9" * 5000), "range"),
        (entry(more=1), "more: "),
        ('{"model": 5}', "kind: Field required"),
    ],
    ids=range(20),
)
def test_a_damaged_entry_is_refused_with_its_line_and_its_reason(tmp_path, line, reason):
    path = tmp_path / "changes.jsonl"
    path.write_text(f'{{"model": "{"a" * 64}"}}\n{line}\n')
    with pytest.raises(InputError, match=f"line 2: is no entry of a change log: .*({reason})"):
        ChangeLog(path, MODEL)


def test_a_log_of_two_writers_is_refused(tmp_path):
    path = tmp_path / "changes.jsonl"
    path.write_text("".join(f"{event(number).to_json()}\n" for number in (1, 3, 2)))
    with pytest.raises(InputError, match=r"an entry of 0\.2 s follows one of 0\.3 s; use a new file"):
        read_events(path)


EDITS = [b"", b"0", b"e9", b"[", b'"', b"\xff", b"\n"]


def test_whatever_bytes_are_changed_a_log_is_read_or_refused(tmp_path):
    rng = np.random.default_rng(5)
    path = tmp_path / "changes.jsonl"
    log = ChangeLog(path, MODEL)
    for number in range(1, 6):
        log.write(event(number))
    log.close()
    content = path.read_bytes()
    for _ in range(300):
        edited = bytearray(content)
        for place in rng.integers(len(edited), size=rng.integers(1, 4)):
            edited[place : place + rng.integers(3)] = rng.choice(
                [b"", b"0", b"e9", b"[", b'"', b"\xff", b"\n"]
            )
        path.write_bytes(edited)
        with contextlib.suppress(InputError):
            read_events(path, MODEL)


@pytest.mark.skipif(os.name == "nt", reason="there are no such files")
def test_a_pipe_is_no_change_log(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: cannot be a change log: expected a file"):
        ChangeLog(tmp_path / "pipe", MODEL)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "huge").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match=r"huge, line 1: .* longer than 65536 bytes"):
        ChangeLog(tmp_path / "huge", MODEL)
