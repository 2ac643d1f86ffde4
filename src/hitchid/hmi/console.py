"""What connects pages, bench loop, model and jobs; all in one event loop."""

import asyncio
import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import hitchid
from hitchid.bench.parameter_files import parameter_sets
from hitchid.errors import InputError, OutputError
from hitchid.hmi import project
from hitchid.hmi.child import Child
from hitchid.hmi.clients import Client, Clients, Pending
from hitchid.hmi.disk import Disk
from hitchid.hmi.jobs import Jobs
from hitchid.hmi.model_beside import ModelBeside
from hitchid.hmi.recorder import History, SpeedEstimate, block_of, packed_rows
from hitchid.hmi.source import DISPLACEMENT, REQUIRED, Signal

ALIVE_S = 0.1  # s between signs of life to the bench loop
LONGEST_SILENCE_S = 1.5  # s: three states that the bench loop did not tell, after which it hangs
MEASURED = 0  # kind of the message with samples
LOG_FILE = "hmi.log"
OPERATED = ("connect", "disconnect", "arm", "start", "reset", "target", "record")  # by the bench loop
BESIDE = ("monitor_restart", "adapt", "roll_back", "save_adapted")  # by the model beside the machine
UNLOGGED = ("target", "monitor_restart")  # requests that leave no line in the log
LOGGED_FIELDS = ("source", "options", "plan", "on", "direction", "name")  # of a request
NOMINAL = "nominal"  # the rig that is offered first
MOVING = ("armed", "running")  # states in which something may move
SPEEDS = (1, 2, 5, 10, 20)
MOST_MARKERS = 200
SILENT = "the bench loop does not answer: whether the machine moves is not known; use its own emergency stop"
NOTHING = dict.fromkeys(("source", "run", "recording", "limits"))
ENDED = {"state": "disconnected", **NOTHING, "mode": "hold"}


@dataclass(frozen=True)
class Settings:
    """Settings of a session.

    Attributes:
        root: folder of the project.
        source: given at the command line, beside the virtual bench and replay; empty for none.
        allow_output: whether a real machine may be moved.
        limits_file: limits of a real machine.
        longest_silence_s: without a sign of life of the operator's page, s.
    """

    root: Path
    source: str = ""
    allow_output: bool = False
    limits_file: Path | None = None
    longest_silence_s: float = 0.5


class Console:
    """State of a session, and what its pages ask for."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.clients = Clients()
        self.jobs = Jobs(settings.root, self.clients.publish, self._project_changed)
        self.history: History | None = None  # of a source: its signals and sampling time are not known before
        self._speed = SpeedEstimate(1, 1.0)
        self._bench: Child | None = None
        self._beside = ModelBeside(settings.root, self.clients, self.publish_status, self._project_changed)
        self._status: dict[str, Any] = {**ENDED, "reason": ""}
        self._markers: list[dict[str, object]] = []
        self._pending = Pending()
        self._heard_s, self._is_zero_sent = 0.0, None
        self._disk, self._disk_problem = Disk(), ""  # nor does the server wait for its own log
        self._tasks: set[asyncio.Task] = set()

    async def keep_alive(self) -> None:
        """Start the bench loop, and give it signs of life until cancelled."""
        self._start_bench()
        while True:
            await asyncio.sleep(ALIVE_S)
            if self._bench is not None:
                # With its time: what waits in the link is read later, and no sign of life of then.
                self._bench.send({"type": "server_alive", "at_s": time.monotonic()})
            # A bench loop that hangs while something may move is told; its next word replaces that.
            silent_s = time.monotonic() - self._heard_s
            may_move = self._bench is not None and self._status["state"] in MOVING
            if may_move and silent_s > LONGEST_SILENCE_S and self._status["reason"] != SILENT:
                self._status = {**self._status, "reason": SILENT}
                self.publish_status()
            self._check_log()

    async def end(self) -> None:
        """End all processes; the bench loop closes valves and logs."""
        if self._bench is not None:
            await asyncio.to_thread(self._bench.end)  # first: valves before models and jobs
        await asyncio.to_thread(self._beside.end)
        await self.jobs.end()

    def welcome(self, session: str) -> Client:
        """Return a client for a new page; the operator's where there is none and nothing may move."""
        # Whoever opens a page while something may move must ask for the place of the operator.
        client = self.clients.add(session, may_operate=self._status["state"] not in MOVING)
        if self.clients.operator == client.name:
            self.log("claim", client)
        return client

    def part(self, client: Client) -> None:
        """Remove a page that has gone."""
        was_operator = self.clients.operator == client.name
        self.clients.remove(client)
        if was_operator:
            self._operator_left()
        self.publish_status()

    async def greet(self, client: Client) -> None:
        """Send a new page what it needs to know."""
        sources = await asyncio.to_thread(self._sources)  # which looks through the project's folders
        client.put(
            {
                "type": "hello",
                "version": hitchid.__version__,
                "you": client.name,
                "allow_output": self.settings.allow_output,
                "sources": sources,
            }
        )
        client.put(self.status())
        client.put(self._beside.describe())
        for job in self.jobs.describe():
            client.put(job)

    def _sources(self) -> list[dict[str, object]]:
        """Return the sources that may be connected, and their options."""
        speed, given = list(SPEEDS), self.settings.source
        rigs = {"rig": sorted(parameter_sets(), key=lambda name: name != NOMINAL), "speed": speed}
        replays = {"log": project.logs(self.settings.root), "speed": speed}
        return [
            *([{"name": given, "label": given, "options": {}}] if given else []),
            {"name": "rig", "label": "virtual bench", "options": rigs},
            {"name": "replay", "label": "replay of a log", "options": replays},
        ]

    def status(self) -> dict[str, object]:
        """Return the state of the session as a message."""
        return {
            "type": "status",
            "late_ticks": 0,
            "target_mm": None,
            "now_s": 0.0,
            **self._status,
            "operator": self.clients.operator,
            "viewers": max(0, len(self.clients) - (self.clients.operator is not None)),
            "model": self._beside.model,
            "markers": self._markers,
        }

    def publish_status(self) -> None:
        """Send the state to all pages."""
        self.clients.publish(self.status())

    def handle(self, client: Client, request: Mapping[str, Any]) -> None:
        """Carry out a request of a page, or pass it on to the bench loop; each is answered.

        Raises:
            InputError: the request is not understood, or not allowed to this page.
        """
        kind = request.get("type")
        is_operator = self.clients.operator == client.name
        if kind == "heartbeat":  # several a second: neither answered nor logged
            if is_operator and self._bench is not None:
                self._bench.send({"type": "page_alive", "at_s": time.monotonic()})
            return
        if kind == "stop":  # which anybody may who watches
            reason = f"stopped by {'the operator' if is_operator else 'a viewer'}"
            self._to_bench(client, {"type": "stop", "id": request.get("id"), "reason": reason})
            return
        if kind == "claim":
            if not self.clients.claim(client):
                raise InputError("another page is the operator; it must be released there first")
            self.log("claim", client)
            self.publish_status()
        elif not is_operator:
            raise InputError("this page only watches; become the operator first")
        elif kind == "release":
            self.log("release", client)
            self.clients.release(client)
            self._operator_left()
            self.publish_status()
        elif kind in OPERATED:
            self._operate(client, request)
            return
        elif kind in BESIDE:
            self._beside.ask(client, request)
            self._log_request(client, request)
            return
        elif kind == "monitor":
            self._beside.choose(request.get("model"), self._status["source"])
        elif kind == "marker":
            if self._status["source"] is None:
                raise InputError("marker: there is no source; connect one first")
            marker = {"time_s": self._status["now_s"], "text": str(request.get("text", ""))[:80]}
            self._markers = [*self._markers, marker][-MOST_MARKERS:]
            self.publish_status()
        else:
            raise InputError(f"{kind!r:.40} is no request")
        client.put({"type": "reply", "id": request.get("id"), "error": None})

    def log(self, event: str, client: Client | None, **content: object) -> None:
        """Append who did what to the log of the project."""
        entry = {"time": datetime.now(UTC).isoformat(timespec="milliseconds"), "event": event}
        line = json.dumps({**entry, "page": client and client.name, **content})
        if not self._disk_problem:  # lines that nothing takes would pile up
            self._disk.put(partial(_append, self.settings.root / LOG_FILE, f"{line}\n".encode()))

    def _check_log(self) -> None:
        """Tell all pages once that the log is not written."""
        before, self._disk_problem = self._disk_problem, ""
        try:
            self._disk.check()
        except OutputError as error:
            self._disk_problem = str(error)
            if not before:
                self.clients.publish({"type": "problem", "text": f"{LOG_FILE}: {error}"})

    def _log_request(self, client: Client, request: Mapping[str, Any]) -> None:
        if request["type"] not in UNLOGGED:
            content = {name: request[name] for name in LOGGED_FIELDS if name in request}
            self.log(request["type"], client, **content)

    def _operator_left(self) -> None:
        if self._bench is not None:
            self._bench.send({"type": "operator_left"})

    def _operate(self, client: Client, request: Mapping[str, Any]) -> None:
        self._log_request(client, request)  # before it is carried out: also one that ends the loop is logged
        if request["type"] == "connect":
            if self._bench is None:
                self._start_bench()
            # No other: a page must not name a module to import, or a device to write to.
            given = request.get("source")
            if given not in ("rig", "replay", self.settings.source):
                raise InputError(f"source: expected rig, replay or the one of --source, got {given!r:.60}")
        self._to_bench(client, request)

    def _to_bench(self, client: Client, request: Mapping[str, Any]) -> None:
        if self._bench is None:
            raise InputError("the bench loop has ended; connect a source to start it again")
        # Under a number of its own, as pages number their requests alike.
        number = self._pending.add(client, request.get("id"))
        self._bench.send({**request, "id": number, "at_s": time.monotonic()})
        if request["type"] == "stop" and self._status["state"] != "stopped":
            self.log("stop", client)

    def _start_bench(self) -> None:
        limits = self.settings.limits_file
        settings = {
            "root": str(self.settings.root),
            "allow_output": self.settings.allow_output,
            "limits_file": str(limits) if limits else None,
            "longest_silence_s": self.settings.longest_silence_s,
        }
        self._heard_s, self._is_zero_sent = time.monotonic(), None
        self._bench = Child("hitchid.hmi.bench_process", settings, self._from_bench, self._bench_ended)

    def _bench_ended(self) -> None:
        self._bench = None
        # What is known of the commands that it has left behind.
        source, state, reason = (self._status[name] for name in ("source", "state", "reason"))
        if self._is_zero_sent is not None:  # the watchdog's word, said after the loop's last one
            has_sent = "has sent zero to the machine"
            could_not = "could not send zero: close the valves of the machine by hand"
            last = f"its watchdog {has_sent if self._is_zero_sent else could_not}"
        elif state not in MOVING:
            last = f"before that: {reason}" if reason else "zero was the last that it commanded"
        elif source["name"] == "rig":
            last = "the virtual bench has ended with it"
        else:
            last = "whether zero was sent is not known: look at the machine, and close its valves by hand"
        reason = f"the bench loop has ended; {last}"
        self._status = {**ENDED, "reason": reason}
        self._pending.fail(reason)
        self.log("ended", None, reason=reason)
        self.publish_status()

    def _from_bench(self, message: bytes) -> None:
        self._heard_s = time.monotonic()
        if message[:1] == b"b":
            wall_ms, rows = block_of(message[1:])
            # Else a block of a source that was left meanwhile.
            if self.history is not None and rows.shape[1] + 1 == self.history.columns:
                rows = np.column_stack([rows, self._speed.advance(rows)])
                self.history.append(rows)
                self.clients.publish(packed_rows(MEASURED, rows, wall_ms))
            self._beside.take(rows, wall_ms)
            return
        content = json.loads(message[1:])
        if content["type"] == "reply":
            self._pending.answer(content["id"], content["error"])
            return
        if content["type"] == "watchdog":
            self._is_zero_sent = content["zero_sent"]
            return
        source = content["source"]
        if source is not None:  # whose speed the server adds
            unit = next(signal["unit"] for signal in source["signals"] if signal["name"] == DISPLACEMENT)
            source["signals"].append(asdict(Signal("speed", "Speed", f"{unit}/s", "speed")))
        before, self._status = self._status, content
        if before["source"] != source:  # samples, markers and model are of the one that was left
            self.history, self._markers = None, []
            if source is not None:
                self.history = History(1 + len(source["signals"]), source["step_s"])
                self._speed = SpeedEstimate(1 + REQUIRED.index(DISPLACEMENT), source["step_s"])
            self._beside.leave()
        self.publish_status()
        if before["run"] and not self._status["run"]:
            self._project_changed()
        if self._status["state"] == "stopped" and before["state"] != "stopped":
            self.log("stopped", None, reason=self._status["reason"])

    def _project_changed(self) -> None:
        self.clients.publish({"type": "project_changed"})

        async def tell() -> None:
            # Looking for logs to replay takes a while where there are many.
            self.clients.publish({"type": "sources", "sources": await asyncio.to_thread(self._sources)})

        task = asyncio.get_running_loop().create_task(tell())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _append(path: Path, line: bytes) -> None:
    """Append a line to a file; neither to what a link leads to, nor waiting for the reader of a pipe."""
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        file = os.open(path, flags, 0o644)
        try:
            os.write(file, line)
        finally:
            os.close(file)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}") from error
