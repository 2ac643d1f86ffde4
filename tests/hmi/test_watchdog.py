"""Whoever stops the bench loop, and however: zero is sent, and the loop that goes on is told."""

import json
import os
import select
import signal
import socket
import time
from functools import partial
from multiprocessing.connection import Connection

import pytest

from fake_bench import Machine
from hitchid.hmi.bench_process import Link
from hitchid.hmi.safety import State
from hitchid.hmi.watchdog import Watchdog

NEVER_S = 60.0
LONGEST_S = 30.0  # s for another process on a machine with much else to do


class Wire:
    """A wire to the valves, which any process can send to, and a second one to the server."""

    def __init__(self):
        self.read, self.write = os.pipe()
        self.server_end, self.tell = os.pipe()

    def zero(self):
        os.write(self.write, b"0")

    def say(self, sent):
        os.write(self.tell, b"yes" if sent else b"no")

    def taken(self, wire, longest_s=LONGEST_S):
        """Return what has arrived at the other end; nothing after `longest_s` s."""
        return os.read(wire, 100) if select.select([wire], [], [], longest_s)[0] else b""


@pytest.fixture
def wire():
    """Return a wire to the valves."""
    return Wire()


def ended(watchdog):
    """Wait for the end of a watchdog; return whether it ended by itself."""
    return os.waitpid(watchdog.process, 0)[1] == 0


def is_gone(watchdog):
    """Wait until nothing is left of a watchdog that was ended."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        try:
            os.kill(watchdog.process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.001)
    return False


def test_a_killed_loop_leaves_closed_valves_and_the_server_hears(wire):
    watchdog = Watchdog(wire.zero, NEVER_S, wire.say)
    watchdog._link.close()  # what the system does for a process that is killed
    assert wire.taken(wire.read)[:1] == b"0"
    assert wire.taken(wire.server_end) == b"yes"
    assert ended(watchdog)


@pytest.mark.parametrize("hangs", [False, True])
def test_a_source_without_a_zero_is_said_or_ends_it(wire, hangs):
    def fail():
        if hangs:
            time.sleep(NEVER_S)
        raise OSError("the plug was pulled")

    watchdog = Watchdog(fail, NEVER_S, wire.say)
    watchdog._link.close()
    assert hangs or wire.taken(wire.server_end) == b"no"
    assert ended(watchdog) != hangs


def test_a_silent_loop_hears_that_zero_was_sent(wire):
    watchdog = Watchdog(wire.zero, 0.02, wire.say)
    assert wire.taken(wire.read)[:1] == b"0"  # this process stands still meanwhile, as one that is frozen
    while watchdog.alive():  # until its word has arrived
        assert wire.taken(wire.read)
    watchdog.end()
    assert is_gone(watchdog)


@pytest.mark.parametrize("frozen", [False, True])
def test_a_loop_that_ends_in_order_is_left_alone(wire, frozen):
    """Also by a watchdog that was frozen meanwhile."""
    watchdog = Watchdog(wire.zero, NEVER_S, wire.say)
    if frozen:
        os.kill(watchdog.process, signal.SIGSTOP)
    assert all(watchdog.alive() for _ in range(1000))  # more than wait in a socket
    watchdog.end()
    assert is_gone(watchdog)
    assert wire.taken(wire.read, 0.0) == wire.taken(wire.server_end, 0.0) == b""


def test_a_watchdog_that_was_killed_is_noticed():
    watchdog = Watchdog(lambda: None, NEVER_S, lambda _: None)
    os.kill(watchdog.process, signal.SIGKILL)
    assert not ended(watchdog)
    assert not watchdog.alive()


class Watched(Machine):
    """A machine at the end of a wire."""

    def __init__(self, wire):
        super().__init__()
        self.wire = wire

    def write(self, commands):
        super().write(commands)
        os.write(self.wire.write, b"+" if any(commands) else b"0")


def test_a_run_is_over_once_the_watchdog_had_to_act(make_bench, write_test, wire):
    watch = partial(Watchdog, tell=wire.say)
    bench = make_bench(Watched(wire), allow_output=True, watch=watch)
    bench.run(**write_test(lifting=0.36, duration_s=600.0))
    bench.tick(5)
    while not wire.taken(wire.read).endswith(b"0"):  # silent: the zero comes from the other process
        pass
    end_s = time.monotonic() + LONGEST_S
    while bench.state is State.RUNNING and time.monotonic() < end_s:  # its word may come a moment later
        bench.tick()
        wire.taken(wire.read, 0.0)
    assert "its watchdog has sent zero" in bench.reason
    assert bench.plant.sent[-1] == (0.0, 0.0)
    bench.tick(20)
    assert set(bench.plant.sent[-20:]) == {(0.0, 0.0)}


def test_a_server_frozen_within_a_message_is_not_waited_for():
    own, other = socket.socketpair()
    link = Link(Connection(own.detach()))
    message = json.dumps({"type": "server_alive", "at_s": 1.0}).encode()
    whole = len(message).to_bytes(4, "big") + message
    other.sendall(whole[:10])
    assert link.requests() == []
    other.sendall(whole[10:])
    end_s = time.monotonic() + LONGEST_S
    while not (requests := link.requests()):
        assert time.monotonic() < end_s
    assert requests == [{"type": "server_alive", "at_s": 1.0}]
    other.sendall(whole[:10])
    other.close()
    with pytest.raises(EOFError):
        any(time.monotonic() > end_s for _ in iter(link.requests, None))
