"""The model beside the machine, as the server knows it: its process, and what pages ask of it."""

import asyncio
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import InputError
from hitchid.hmi import project
from hitchid.hmi.child import Child
from hitchid.hmi.clients import Client, Clients, Pending
from hitchid.hmi.source import DISPLACEMENT, LIFTING_COMMAND

BLOCK = b"b"  # first byte of a message with samples, see `monitor_loop`
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
