"""Links open once and for an hour; sessions are bounded; the command says what it needs."""

import os
import socket
import sys

import pytest

pytest.importorskip("starlette")

from hitchid import cli
from hitchid.errors import InputError
from hitchid.hmi import guard, project, server
from hitchid.hmi.console import Settings
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
    assert list(map(sessions.session_of, opened)) == opened
    assert not any(map(sessions.session_of, [*tokens, "", "é", "\ud800", opened[0][:-1]]))


@pytest.mark.parametrize("token", ["\ud800", "é", "\0", "", "a" * 10**6])
def test_a_guess_is_refused_and_uses_up_no_link(token):
    sessions = Sessions()
    link = sessions.new_link()
    assert sessions.redeem(token) is None
    assert sessions.redeem(link)


def test_with_one_too_many_the_oldest_unconnected_session_ends():
    sessions = Sessions()
    operator, *viewers = [sessions.redeem(sessions.new_link()) for _ in range(MOST_SESSIONS)]
    sessions.connect(operator)
    sessions.session_of(viewers[0])
    assert sessions.redeem(sessions.new_link())
    still = [sessions.session_of(session) is not None for session in (operator, *viewers)]
    assert still == [True, True, False] + [True] * (MOST_SESSIONS - 3)
    sessions = Sessions()
    opened = [sessions.redeem(sessions.new_link()) for _ in range(MOST_SESSIONS)]
    for session in opened:
        sessions.connect(session)
    assert sessions.redeem(sessions.new_link()) is None
    sessions.disconnect(opened[7])
    assert sessions.redeem(sessions.new_link())
    assert [sessions.session_of(session) for session in opened].count(None) == 1


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


def test_what_cannot_be_served_is_refused_before_it_is(refused, tmp_path):
    assert "--allow-output: requires --limits FILE" in refused("--allow-output")
    assert "nowhere: is no folder; create it first" in refused("nowhere")
    (tmp_path / "limits.toml").write_text("lifting_command = -1\n")
    assert "lifting_command" in refused("--limits", "limits.toml")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert f"port {port}: Address already in use; choose another --port" in refused("--port", port)
    assert project.lock(tmp_path, "http://127.0.0.1:8123/") is not None  # until this process ends
    assert "is served already, at http://127.0.0.1:8123/; open that, or end it first" in refused(".")


def test_a_server_that_is_refused_leaves_no_socket_open(tmp_path, monkeypatch):
    class Remembered(socket.socket):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(self)

    made = []
    monkeypatch.setattr(server.socket, "socket", Remembered)
    file = project.lock(tmp_path, "http://127.0.0.1:8123/")
    with pytest.raises(InputError, match="is served already"):
        server.Server(Settings(tmp_path))
    os.close(file)
    assert [each.fileno() for each in made] == [-1]


def test_a_project_is_free_again_when_its_server_has_ended(tmp_path):
    os.close(project.lock(tmp_path, "http://127.0.0.1:8123/"))
    file = project.lock(tmp_path, "http://127.0.0.1:1/")
    assert (tmp_path / project.LOCK_FILE).read_text() == "http://127.0.0.1:1/"
    os.close(file)
    (tmp_path / project.LOCK_FILE).unlink()
    (tmp_path / project.LOCK_FILE).symlink_to(tmp_path / "elsewhere")
    assert project.lock(tmp_path, "") is None
    assert not (tmp_path / "elsewhere").exists()
