"""The model beside the machine, as the server knows it: its process, and what pages ask of it."""

import asyncio
import json
import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import InputError
from hitchid.hmi import project
from hitchid.hmi.child import Child
from hitchid.hmi.clients import Client, Clients, Pending
from hitchid.hmi.source import DISPLACEMENT, LIFTING_COMMAND
from hitchid.live import ChangeLog, Changes, Event, OnlineAdaptation
from hitchid.live.events import AT_LIMIT, CHANGE_DETECTED, FAULT, LEARNED, PROMOTED, REFUSED, ROLLED_BACK
from hitchid.model import Hitch, save

# Adaptation of the model beside the machine: its start, its change log, and what the page shows of it.

STARTING, ON = "starting", "on"
# Kinds of events that are shown, and how many: refused strokes must not hide the others; chosen.
SHOWN = {(PROMOTED, ROLLED_BACK, CHANGE_DETECTED, AT_LIMIT, FAULT): 6, (REFUSED,): 2}


class ModelAdaptation:
    """Adaptation of one model, in the units of a source.

    It starts in a thread of its own, as that takes seconds: the predictions go on meanwhile.

    Args:
        model: identified hitch.
        path: of its change log; adaptation goes on from an existing one.
        command_factors: direction to what a command of the source is multiplied by to be in the model's unit.

    Raises:
        InputError, OutputError: the file is no change log, that of another model, or cannot be written.
    """

    def __init__(self, model: Hitch, path: Path, command_factors: Mapping[str, float]) -> None:
        self._factors, self._at_s = command_factors, 0.0
        self._log = ChangeLog(path, model)
        self._promoted: Counter[str] = Counter()
        self._strokes: Counter[str] = Counter()
        self._events = {kinds: deque[dict[str, Any]](maxlen=most) for kinds, most in SHOWN.items()}
        for event in self._log.earlier:  # a promotion of an earlier sitting can be taken back as well
            self._count(event)
        self._directions = tuple(model.channels)
        executor = ThreadPoolExecutor(1)
        self._starting: Future[OnlineAdaptation] = executor.submit(
            OnlineAdaptation, model, log=self._take, earlier=self._log.earlier
        )
        executor.shutdown(wait=False)  # its thread ends with this one task
        self._online: OnlineAdaptation | None = None

    @property
    def model(self) -> Hitch | None:
        """The model in use; None before the start."""
        return None if self._online is None else self._online.model

    def start(self) -> bool:
        """Return whether it has started since the last call.

        Raises:
            InputError: the model cannot be adapted.
        """
        if self._online is not None or not self._starting.done():
            return False
        self._online = self._starting.result()
        return True

    def feed(self, begin_s: float, commands: np.ndarray, displacement: np.ndarray) -> bool:
        """Take a block of samples in the model's units, the first at `begin_s`; say if anything was learned.

        Commands are of shape [B, 2], displacements, NaN where there is none, of shape [B].

        Raises:
            OutputError: the change log cannot be written.
        """
        if self._online is None:
            return False
        self._at_s = begin_s  # of the source's clock, by which the page shows when an event took effect
        return bool(self._online.feed(commands, displacement))

    def roll_back(self, direction: object) -> None:
        """Return to the parameters of one direction before its last promotion, as soon as nothing moves."""
        self._started.rollback(str(direction))

    def save(self, folder: Path) -> None:
        """Write the model in use.

        Raises:
            OutputError: the folder exists, or cannot be written.
        """
        save(self._started.model, folder)

    def end(self) -> None:
        """End learning; strokes that are being learned from go into the change log."""
        if self._online is None:
            self._starting.add_done_callback(_abandon)
        else:
            self._online.finish()
        self._log.close()

    def describe(self) -> dict[str, object]:
        """Return what the page shows: parameters in use in the units of the source, newest events first."""
        changes = {} if self._online is None else self._online.changes
        return {
            "state": STARTING if self._online is None else ON,
            "strokes": {"learned": self._strokes[LEARNED], "refused": self._strokes[REFUSED]},
            "directions": {
                direction: {
                    **self._shown(direction, changes.get(direction, Changes())),
                    "can_roll_back": self._online is not None and self._promoted[direction] > 0,
                }
                for direction in self._directions
            },
            "events": sorted(chain(*self._events.values()), key=itemgetter("at_s"), reverse=True),
        }

    @property
    def _started(self) -> OnlineAdaptation:
        if self._online is None:
            raise InputError("adaptation has not started yet; wait until it is on")
        return self._online

    def _take(self, event: Event) -> None:
        self._log.write(event)
        self._count(event)
        self._strokes[event.kind] += 1
        shown = {"kind": event.kind, "direction": event.direction, "reason": event.reason, "at_s": self._at_s}
        for kinds, latest in self._events.items():
            if event.kind in kinds:
                latest.append({**shown, **self._shown(event.direction, event.changes)})

    def _count(self, event: Event) -> None:
        """Count the promotions that can be taken back."""
        if event.kind == PROMOTED:
            self._promoted[event.direction] += 1
        elif event.kind == ROLLED_BACK:
            self._promoted[event.direction] = max(0, self._promoted[event.direction] - 1)

    def _shown(self, direction: str, changes: Changes) -> dict[str, float]:
        return {
            "gain_percent": 100 * math.expm1(changes.gain),
            "dead_zone": changes.dead_zone / self._factors.get(direction, 1.0),
        }


def _abandon(starting: Future[OnlineAdaptation]) -> None:
    """End an adaptation that has started after it was switched off."""
    if not starting.cancelled() and starting.exception() is None:
        starting.result().finish()


BLOCK = b"b"  # first byte of a message with samples, see `monitor_process`
ENDED = "the model beside the machine has ended; choose it again"
NO_ADAPTATION: Mapping[str, object] = {
    "state": "off",
    "reason": "",
    "strokes": {},
    "directions": {},
    "events": [],
}


class ModelBeside:
    """The model beside the machine, by its folder relative to the project; none before one was chosen.

    `on_change` is called when another one was chosen, or its process has ended; `on_written` when a model was
    written into the project.
    """

    def __init__(
        self, root: Path, clients: Clients, on_change: Callable[[], None], on_written: Callable[[], None]
    ) -> None:
        self._root, self._clients = root, clients
        self._on_change, self._on_written = on_change, on_written
        self.model: str | None = None
        self._child: Child | None = None
        self._pending = Pending()
        self._adaptation = NO_ADAPTATION
        self._has_said_why = False

    def choose(self, model: object, source: Mapping[str, Any] | None) -> None:
        """Start another model beside a source; None ends the present one.

        Raises:
            InputError: there is no source, or no such model.
        """
        if model is None:
            self.leave()
            return
        if source is None:
            raise InputError("monitor: there is no source; connect one first")
        units = {signal["name"]: signal["unit"] for signal in source["signals"]}
        settings = {
            "model": str(project.inside(self._root, model)),
            "units": [units[LIFTING_COMMAND], units[DISPLACEMENT]],
            "step_s": source["step_s"],
        }
        self.leave()  # only after all that may be refused: a wrong choice leaves the present one
        child = Child("hitchid.hmi.monitor_loop", settings, self._take, lambda: self._has_died(child))
        self._child, self.model, self._has_said_why = child, str(model), False
        self._on_change()

    def leave(self) -> None:
        """End the model that there is, without waiting."""
        if self._child is not None:
            child = self._child
            self._has_ended(child)
            # Beside the event loop: ending waits for the process, up to seconds.
            asyncio.get_running_loop().run_in_executor(None, child.end)

    def end(self) -> None:
        """End the process, and wait for it."""
        if self._child is not None:
            self._child.end()

    def ask(self, client: Client, request: Mapping[str, Any]) -> None:
        """Pass a request on; the process answers it.

        Raises:
            InputError: there is no model, or a name is none or taken.
        """
        if self._child is None or self.model is None:
            raise InputError(f"{request['type']}: there is no model beside the machine; choose one first")
        content = {name: request[name] for name in ("on", "direction") if name in request}
        match request["type"]:
            case "adapt":
                content = {"on": request.get("on") is True, "log": str(self._root / self.change_log)}
            case "save_adapted":
                path = f"{project.MODELS}/{project.checked_name(request.get('name'))}"
                content = {"folder": str(project.place(self._root, path))}
        number = self._pending.add(client, request.get("id"))
        self._child.send({**content, "type": request["type"], "id": number})

    @property
    def change_log(self) -> str:
        """Path of the model's change log, relative to the project."""
        return f"{project.CHANGES}/{Path(self.model or '').name}.jsonl"

    def take(self, rows: np.ndarray, wall_ms: float) -> None:
        """Pass samples on: time, s; commands, displacement and others, shape [N, columns]."""
        if self._child is not None:
            columns = [np.full(len(rows), wall_ms), *rows[:, :4].T]
            self._child.outbox.put(BLOCK + np.column_stack(columns).tobytes(), is_block=True)

    def describe(self) -> dict[str, object]:
        """Return what is known of the adaptation, as a message."""
        return {"type": "adaptation", "log": self.change_log if self.model else "", **self._adaptation}

    def _take(self, message: bytes) -> None:
        if message[:1] != b"{":
            self._clients.publish(message)
            return
        content = json.loads(message)
        match content.pop("type"):
            case "reply":
                self._pending.answer(content["id"], content["error"])
                if content["written"]:
                    self._on_written()
            case "error":
                self._has_said_why = True
                self._clients.publish({"type": "problem", "text": f"monitor: {content['error']}"})
            case _:
                self._tell(content)

    def _tell(self, adaptation: Mapping[str, object]) -> None:
        self._adaptation = adaptation
        self._clients.publish(self.describe())

    def _has_died(self, child: Child) -> None:
        """Tell all pages of a process that has ended without being asked to."""
        if self._child is child and not self._has_said_why:
            text = f"monitor: the process of {self.model} was killed, or out of memory; choose it again"
            self._clients.publish({"type": "problem", "text": text})
        self._has_ended(child)

    def _has_ended(self, child: Child) -> None:
        if self._child is child:  # else it was left before: another one may have its place
            self._child = self.model = None
            self._pending.fail(ENDED)
            self._tell(NO_ADAPTATION)
            self._on_change()
