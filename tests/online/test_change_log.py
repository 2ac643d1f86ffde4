"""The change log as a file: every event at once, and on from where it was, also after a cut line."""

from dataclasses import replace

import pytest

import handmade
from hitchid.adaptation import Changes, Event, read_events
from hitchid.errors import InputError, OutputError
from hitchid.online import ChangeLog

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
    assert ChangeLog(path, UNSAVED).earlier == ChangeLog(path, MODEL).earlier == (event(1),)
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
