"""Links open once and for an hour; sessions are bounded; the command says what it needs."""

import socket
import sys

import pytest

pytest.importorskip("starlette")

from hitchid import cli
from hitchid.hmi import guard
from hitchid.hmi.guard import LINK_S, MOST_SESSIONS, Sessions


@pytest.fixture
def clock(monkeypatch):
    """Return a list with the present time, s, which a test may change."""
    now_s = [1000.0]
    monkeypatch.setattr(guard.time, "monotonic", lambda: now_s[0])
    return now_s


@pytest.mark.parametrize(("age_s", "is_open"), [(0.0, True), (LINK_S - 1, True), (LINK_S + 1, False)])
def test_a_link_is_open_for_an_hour(clock, age_s, is_open):
    sessions = Sessions()
    token = sessions.new_link()
    clock[0] += age_s
    assert (sessions.redeem(token) is not None) == is_open
    assert sessions.redeem(token) is None


def test_each_link_and_each_session_is_another():
    sessions = Sessions()
    tokens = [sessions.new_link() for _ in range(20)]
    opened = [sessions.redeem(token) for token in tokens]
    assert len({*tokens, *opened}) == 40
    assert all(map(sessions.is_known, opened))
    assert not any(map(sessions.is_known, [*tokens, "", "é", opened[0][:-1]]))


def test_the_oldest_session_ends_with_one_too_many():
    sessions = Sessions()
    opened = [sessions.redeem(sessions.new_link()) for _ in range(MOST_SESSIONS + 1)]
    assert [sessions.is_known(session) for session in opened] == [False] + [True] * MOST_SESSIONS


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Return a function that gives the message with which the command refuses to start."""
    monkeypatch.chdir(tmp_path)

    def message(*arguments):
        monkeypatch.setattr(sys, "argv", ["hitchid", "hmi", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 2
        output = capsys.readouterr()
        assert output.out == ""
        return output.err

    return message


def test_output_without_limits_is_refused(refused):
    assert "--allow-output: requires --limits FILE" in refused("--allow-output")


def test_a_project_that_is_no_folder_is_refused(refused):
    assert "nowhere: is no folder; create it first" in refused("nowhere")


def test_wrong_limits_are_refused_before_anything_is_served(refused, tmp_path):
    (tmp_path / "limits.toml").write_text("lifting_command = -1\n")
    assert "lifting_command" in refused("--limits", "limits.toml")


def test_a_port_that_is_taken_is_refused(refused):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert f"port {port}: Address already in use; choose another --port" in refused("--port", port)
