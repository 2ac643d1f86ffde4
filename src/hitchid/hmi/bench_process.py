"""The process of the bench loop: deadline clock, and the link to the server.

It never waits for the server. A server that is gone closes the valves, the log and the process.
"""

import contextlib
import gc
import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from hitchid._support.processes import Outbox
from hitchid.errors import HitchError, InputError
from hitchid.hmi.bench_loop import BenchLoop
from hitchid.hmi.source import Reading
from hitchid.hmi.watchdog import Watchdog

BLOCK_S = 0.04  # s between blocks of samples to the server: 25 a second
STATUS_S = 0.5  # s between states to the server where nothing changes
LONGEST_START_S = 0.5  # s that a start may wait; a later one would surprise whoever is at the machine; chosen
LATE_TICKS = 5  # ticks behind, after which the clock starts anew instead of catching up; chosen
MOST_REQUESTS = 50  # that are carried out in one tick: pages that send more wait; chosen
MOST_WAITING = 1000  # requests that wait, before the server has to; chosen
# s that a thread may keep the interpreter to itself while the tick is due; by default it would be 5 ms.
SWITCH_S = 0.0005
# Where the user may: the loop goes before other programs, and is ended last where memory runs out; chosen.
PRIORITY, OOM_SCORE = -10, "-500"
REAL_TIME_PRIORITY = 1  # the lowest: before all that is not in real time, behind what the user made so
JSON_MARK, BLOCK_MARK = b"j", b"b"


class Link:
    """Messages to and from the server, neither of which blocks the loop."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._outbox = Outbox(connection)
        self._arrived: queue.Queue[dict | None] = queue.Queue(MOST_WAITING)
        # A server that is frozen in the middle of a message keeps this thread waiting, and nobody else.
        threading.Thread(target=self._receive, daemon=True).start()

    def requests(self) -> list[dict]:
        """Return the requests that have arrived, `MOST_REQUESTS` at most.

        Raises:
            EOFError: the server is gone.
        """
        requests = []
        with contextlib.suppress(queue.Empty):
            while len(requests) < MOST_REQUESTS:
                request = self._arrived.get_nowait()
                if request is None:
                    raise EOFError
                requests.append(request)
        return requests

    def _receive(self) -> None:
        try:
            while True:
                self._arrived.put(json.loads(self._connection.recv_bytes()))
        except (EOFError, OSError, TypeError):  # TypeError: closed by this side in the middle of a message
            self._arrived.put(None)

    def close(self) -> None:
        """End, after what was sent has gone; a server that does not read is not waited for."""
        self._outbox.close(LONGEST_START_S)

    def send(self, content: dict[str, object]) -> None:
        """Send a message."""
        self._outbox.put(JSON_MARK + json.dumps(content).encode())

    def send_block(self, readings: Sequence[Reading]) -> None:
        """Send samples, and the wall clock of the newest one, ms."""
        rows = np.array([(reading.time_s, *reading.values) for reading in readings])
        header = np.array([1e3 * time.time(), rows.shape[1]]).tobytes()
        self._outbox.put(BLOCK_MARK + header + rows.tobytes(), is_block=True)


def run_in_real_time(*, wanted: bool = True) -> None:
    """Let this thread go before all others, where the user may: a busy computer else delays its ticks."""
    with contextlib.suppress(OSError, AttributeError):  # AttributeError: not on macOS
        policy, priority = (os.SCHED_FIFO, REAL_TIME_PRIORITY) if wanted else (os.SCHED_OTHER, 0)
        os.sched_setscheduler(0, policy, os.sched_param(priority))


def run(loop: BenchLoop, link: Link) -> None:
    """Tick until the server is gone."""
    readings: list[Reading] = []
    due_s = block_s = status_s = time.monotonic()
    late_ticks, shown = 0, None
    loop.server_alive(due_s)
    while True:
        try:
            requests = link.requests()
        except EOFError:
            return
        for request in requests:  # before the tick, so that a stop takes effect with this sample
            _answer(loop, link, request)
        now_s = time.monotonic()
        readings += loop.tick(now_s)
        if now_s - block_s >= BLOCK_S and readings:
            link.send_block(readings)
            readings, block_s = [], now_s
        state = (loop.state, loop.commands.any())
        if requests or state != shown or now_s - status_s >= STATUS_S:
            link.send({"type": "status", "late_ticks": late_ticks, **loop.describe()})
            status_s, shown = now_s, state
        due_s += loop.tick_s
        ahead_s = due_s - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)
        elif ahead_s < -LATE_TICKS * loop.tick_s:
            late_ticks += 1
            due_s = time.monotonic()


def _answer(loop: BenchLoop, link: Link, request: dict) -> None:
    """Carry out one request; a source that takes long to open does not count as silence of the server."""
    kind, error = request.get("type"), None
    if kind in ("connect", "arm"):  # what is there stays: no tick should wait while it is looked through
        gc.collect()
        gc.freeze()
    if kind in ("server_alive", "page_alive"):  # of the time it was given, not of the time it is read
        given_s = min(float(request["at_s"]), time.monotonic())
        (loop.server_alive if kind == "server_alive" else loop.page_alive)(given_s)
        return
    if kind == "operator_left":
        loop.operator_left()
        return
    try:
        if kind == "start" and time.monotonic() - float(request["at_s"]) > LONGEST_START_S:
            raise InputError("start came too late; start again")
        loop.handle(request, time.monotonic())
    except HitchError as problem:
        error = str(problem)
    except Exception as problem:  # a source or controller of a user; the loop goes on with closed valves
        error = f"{type(problem).__name__}: {problem}"
    if kind == "connect":  # a virtual bench may be asked for more than a core has, and would take all of it
        run_in_real_time(wanted=not loop.is_virtual)
    if kind in ("connect", "arm"):  # which take long: what waited meanwhile is no silence
        loop.server_alive(time.monotonic())
        loop.page_alive(time.monotonic())
    link.send({"type": "reply", "id": request.get("id"), "error": error})


def main(arguments: Sequence[str]) -> None:
    """Run the bench loop of a server, given the file descriptor of the connection and settings as JSON."""
    from hitchid._support.jax_setup import prepare_jax

    prepare_jax()
    descriptor, settings = int(arguments[0]), json.loads(arguments[1])
    for number in (signal.SIGINT, signal.SIGHUP):  # they end the server, which ends this process
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # by way of the end below, which closes the valves
    sys.setswitchinterval(SWITCH_S)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    limits, connection = settings["limits_file"], Connection(descriptor)

    def tell(is_zero_sent: bool) -> None:
        content = {"type": "watchdog", "zero_sent": is_zero_sent}
        # At once, in the watchdog's process: the thread of an outbox was not forked with it.
        connection.send_bytes(JSON_MARK + json.dumps(content).encode())

    loop = BenchLoop(
        Path(settings["root"]),
        allow_output=settings["allow_output"],
        limits_file=Path(limits) if limits else None,
        longest_silence_s=settings["longest_silence_s"],
        watch=partial(Watchdog, tell=tell),
    )
    link = Link(connection)
    gc.freeze()
    try:
        run(loop, link)
    finally:
        loop.close()
        link.send({"type": "status", **loop.describe()})  # what the server knows when this process is gone
        link.close()
