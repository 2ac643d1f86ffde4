"""What the server says of a bench loop or a model that has ended, and its own log."""

import asyncio
import json
import os

import numpy as np
import pytest

pytest.importorskip("starlette")

from hitchid.hmi import model_beside
from hitchid.hmi.child import Child
from hitchid.hmi.console import LOG_FILE, Console, Settings
from hitchid.hmi.model_beside import ModelBeside

SOURCE = {
    "name": "udp:5005",
    "signals": [{"name": name, "unit": "1"} for name in ("lifting_command", "displacement")],
    "step_s": 0.01,
}


def messages_to(client, kind=None):
    """Return the messages that wait for a page, of one kind."""
    messages = map(json.loads, client._texts)
    return [message for message in messages if kind in (None, message["type"])]


@pytest.mark.parametrize(
    ("state", "source", "zero_sent", "reason"),
    [
        ("running", "udp:5005", True, "its watchdog has sent zero to the machine"),
        ("running", "udp:5005", False, "close the valves of the machine by hand"),
        ("running", "udp:5005", None, "whether zero was sent is not known"),
        ("armed", "udp:5005", None, "whether zero was sent is not known"),
        ("running", "rig", None, "the virtual bench has ended with it"),
        ("idle", "udp:5005", None, "zero was the last that it commanded"),
    ],
)
def test_pages_hear_what_is_known_of_an_ended_loop(tmp_path, state, source, zero_sent, reason):
    console = Console(Settings(tmp_path))
    page = console.clients.add("session")
    console._status |= {"state": state, "source": {**SOURCE, "name": source}}
    if zero_sent is not None:
        console._from_bench(b"j" + json.dumps({"type": "watchdog", "zero_sent": zero_sent}).encode())
    console._bench_ended()
    assert reason in messages_to(page)[-1]["reason"]
    assert "valves are closed" not in messages_to(page)[-1]["reason"]


def test_the_reason_of_a_stop_stays_when_its_loop_ends(tmp_path):
    console = Console(Settings(tmp_path))
    reason = "gone; zero could not be sent: close the valves of the machine by hand"
    console._status |= {"state": "stopped", "reason": reason}
    console._bench_ended()
    assert console.status()["reason"].endswith(reason)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("elsewhere"), os.mkdir])
def test_a_log_that_cannot_be_written_is_one_problem(tmp_path, make):
    make(tmp_path / LOG_FILE)
    console = Console(Settings(tmp_path))
    page = console.clients.add("session")
    for _ in range(3):
        console.log("claim", page)
        assert console._disk.finish()
    console._check_log()
    console._check_log()
    (problem,) = messages_to(page, "problem")
    assert problem["text"].startswith(f"{LOG_FILE}: cannot be written: ")
    assert not (tmp_path / "elsewhere").exists()


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """Return a model beside a source, without its process, and a page."""

    class Process(Child):
        def __init__(self, module, settings, on_message, on_end):
            self.on_message, self.on_end = on_message, on_end

        def end(self):
            pass

    monkeypatch.setattr(model_beside, "Child", Process)
    (tmp_path / "models" / "first").mkdir(parents=True)
    console = Console(Settings(tmp_path))
    beside = ModelBeside(tmp_path, console.clients, lambda: None, lambda: None)
    beside.choose("models/first", SOURCE)
    beside.page = console.clients.add("session")
    return beside


def problems(beside):
    return [message["text"] for message in messages_to(beside.page, "problem")]


def test_a_model_whose_process_dies_says_so(beside):
    beside._child.on_end()
    (problem,) = problems(beside)
    assert "models/first" in problem
    assert "killed, or out of memory; choose it again" in problem
    assert beside.model is None


def test_a_model_that_cannot_be_used_says_why_once(beside):
    beside._child.on_message(json.dumps({"type": "error", "error": "another sampling time"}).encode())
    beside._child.on_end()
    assert problems(beside) == ["monitor: another sampling time"]


def test_a_model_that_is_left_says_nothing(beside):
    async def leave():
        child = beside._child
        beside.leave()
        child.on_end()

    asyncio.run(leave())
    beside.take(np.zeros((1, 4)), 0.0)
    assert problems(beside) == []
