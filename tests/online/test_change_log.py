"""The change log as a file: every event at once, and on from where it was, also after a cut line."""

import pytest

from hitchid.adaptation import Changes, Event, read_events
from hitchid.errors import InputError, OutputError
from hitchid.online import ChangeLog


def event(number):
    return Event("learned", 0.1 * number, number, "lifting", "", Changes(gain=0.1 * number))


def test_events_are_in_the_file_at_once_and_the_next_log_goes_on_from_them(tmp_path):
    path = tmp_path / "new" / "changes.jsonl"
    log = ChangeLog(path)
    assert log.earlier == ()
    log.write(event(1))
    assert read_events(path) == (event(1),)
    log.close()
    again = ChangeLog(path)
    assert again.earlier == (event(1),)
    again.write(event(2))
    assert read_events(path) == (event(1), event(2))


@pytest.mark.parametrize("left", [1, 20, -1])
def test_a_line_that_was_cut_is_left_out_and_spoils_no_later_one(tmp_path, left):
    path = tmp_path / "changes.jsonl"
    path.write_text(f"{event(1).to_json()}\n{event(2).to_json()[:left]}")
    log = ChangeLog(path)
    assert log.earlier == (event(1),)
    log.write(event(3))
    assert read_events(path) == (event(1), event(3))


def test_a_file_that_is_no_change_log_is_refused_and_stays(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nonsense\n")
    with pytest.raises(InputError, match="line 1: is no entry of a change log"):
        ChangeLog(path)
    assert path.read_text() == "nonsense\n"


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/changes\.jsonl: cannot be written"):
        ChangeLog(tmp_path / "file" / "changes.jsonl")
