"""The process that learns from strokes; see `OnlineAdaptation`."""

import json
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid._support.processes import Outbox, connected_module
from hitchid.errors import HitchError, InputError
from hitchid.live.adapter import Adapter
from hitchid.live.events import FAULT, REFUSED, Event, last_sample
from hitchid.live.parameters import Changes, changed_model, numbers_of_models
from hitchid.live.settings import AdaptationSettings
from hitchid.live.strokes import Stroke, StrokeCutter
from hitchid.model import Hitch, Load, load, save

# Messages to and from the process that learns from strokes: a line of JSON, and numbers as float64.


def stroke_message(stroke: Stroke) -> bytes:
    """Return a stroke as a line of JSON and its samples, float64 in the machine's byte order."""
    header = {"direction": stroke.direction, "begin": stroke.begin, "rest": stroke.rest}
    rows = np.column_stack([stroke.commands, stroke.displacement])
    return json.dumps(header).encode() + b"\n" + rows.tobytes()


def stroke_of(message: bytes) -> Stroke:
    """Return the stroke of a message."""
    header, samples = message.split(b"\n", 1)
    rows = np.frombuffer(samples).reshape(-1, 3)
    return Stroke(**json.loads(header), commands=rows[:, :2], displacement=rows[:, 2])


# Adaptation beside a running model: strokes are learned from in a process of its own.

# s after a stroke at which what was learned from it takes effect: longer than learning takes, so that this
# does not depend on the speed of the machine; chosen.
EFFECT_S = 0.5
MOST_PENDING = 8  # strokes that wait; while there are more, further ones are refused; chosen


class OnlineAdaptation:
    """Cuts strokes from samples, and learns from them in another process, one after the other.

    What was learned takes effect half a second after the stroke, or with the first sample after that at which
    no stroke is under way. A sample waits for it only where samples come faster than in real time, as from a
    file. Where the process ends the model stays as it is, and says so once.

    Args:
        model: identified hitch, not one that was adapted.
        settings: of the adaptation; the defaults where None.
        load: covariates, as for `Hitch.simulate`.
        log: called with each event, in the order in which they take effect.
        earlier: events of a change log to go on from.

    Attributes:
        changes: direction to the changes in use.
        numbers: of the physical models in use, see `numbers_of_models`.

    Raises:
        InputError: the model was adapted already, has no gain behind a dead zone, or no such covariate.
    """

    def __init__(
        self,
        model: Hitch,
        settings: AdaptationSettings | None = None,
        *,
        load: Load | None = None,
        log: Callable[[Event], None] | None = None,
        earlier: Sequence[Event] = (),
    ) -> None:
        self._identified, self._log = model, log
        self._samples = last_sample(earlier, model.step_s)
        self._cutter = StrokeCutter(model, self._samples)
        # Of each request the sample from which on its answer counts, and when it was sent, s.
        self._pending: deque[tuple[int, float]] = deque()
        self._ended = False
        self.changes: dict[str, Changes] = {}
        self._bands: dict[str, float] = {}
        self._process, self._connection = connected_module("hitchid.live.adaptation_process")
        self._outbox = Outbox(self._connection)
        if isinstance(load, Mapping):
            plain_load = {name: float(np.asarray(value)) for name, value in load.items()}
        else:
            plain_load = None if load is None else float(np.asarray(load))
        with tempfile.TemporaryDirectory() as folder:
            save(model, Path(folder) / "model")
            given = {
                "model": str(Path(folder) / "model"),
                "settings": asdict(settings or AdaptationSettings()),
                "load": plain_load,
                "earlier": [event.to_json() for event in earlier],
            }
            self._outbox.put(json.dumps(given).encode())
            self._receive()  # waits until the model is read, whose folder is removed, and all is compiled

    @property
    def model(self) -> Hitch:
        """The model with the parameters in use, and with its bands as wide as they had to be."""
        return changed_model(self._identified, self.changes, self._bands)

    def feed(
        self, commands: Float[np.ndarray, "b 2"], displacement: Float[np.ndarray, " b"]
    ) -> tuple[Event, ...]:
        """Take a block of samples; return the events that take effect with it.

        Args:
            commands: lifting and lowering, in the model's units.
            displacement: measured; NaN where there is none.
        """
        events: list[Event] = []
        self._samples += len(displacement)
        for stroke in self._cutter.feed(commands, displacement):
            events += self._learn(stroke)
        if not self._cutter.moves:
            while self._pending and self._samples >= self._pending[0][0]:
                if not self._is_answered(self._pending[0][1]):
                    break
                events += self._receive()
        return self._logged(events)

    def rollback(self, direction: str) -> None:
        """Return to the parameters of one direction before its last promotion, as soon as nothing moves."""
        checks.one_of(direction, self._identified.channels, "direction")
        self._ask(b"rollback " + direction.encode(), self._samples)

    def finish(self) -> tuple[Event, ...]:
        """Wait for what is being learned; return the events that then take effect."""
        events: list[Event] = []
        for stroke in self._cutter.finish():
            events += self._learn(stroke)
        while self._pending and not self._ended:
            events += self._receive()
        self._outbox.close()
        self._process.wait()
        return self._logged(events)

    def _learn(self, stroke: Stroke) -> list[Event]:
        if self._ended:
            return []
        if len(self._pending) >= MOST_PENDING:
            return [self._event(REFUSED, "learning from earlier strokes has not ended", stroke.direction)]
        self._ask(stroke_message(stroke), self._samples + round(EFFECT_S / self._identified.step_s))
        return []

    def _ask(self, message: bytes, due: int) -> None:
        self._pending.append((due, time.monotonic()))
        self._outbox.put(message)

    def _is_answered(self, sent_s: float) -> bool:
        # Samples of a file come faster than in time: these wait for what a machine would have learned by now.
        return self._connection.poll(max(0.0, EFFECT_S - (time.monotonic() - sent_s)))

    def _receive(self) -> list[Event]:
        """Take an answer of the process; return its events."""
        try:
            header, numbers = self._connection.recv_bytes().split(b"\n", 1)
        except (EOFError, OSError):
            self._ended = True
            self._pending.clear()  # nobody answers them any more
            return [self._event(FAULT, "the process that learns has ended; the model stays as it is", "")]
        content = json.loads(header)
        if "error" in content:
            raise InputError(content["error"])
        if self._pending:  # the first answer, to model and settings, is to no stroke
            self._pending.popleft()
        changes = {direction: Changes(*values) for direction, values in content["changes"].items()}
        # Numbers stay the same object where nothing changed: `Live` looks at that.
        if changes != self.changes:
            self.changes, self.numbers = changes, np.frombuffer(numbers)
        self._bands = content["bands"]
        return [Event.from_json(line) for line in content["events"]]

    def _event(self, kind: str, reason: str, direction: str) -> Event:
        return Event(kind, self._samples * self._identified.step_s, 0, direction, reason, Changes())

    def _logged(self, events: Sequence[Event]) -> tuple[Event, ...]:
        if self._log is not None:
            for event in events:
                self._log(event)
        return tuple(events)


def main(arguments: Sequence[str]) -> None:
    """Learn from strokes until the other side is gone.

    The argument is the file descriptor of the connection, whose first message are folder of the model,
    settings, load and earlier events as JSON.
    """
    from hitchid._support.jax_setup import prepare_jax

    # Ctrl-C ends the program that asks, which then waits here for the strokes that were sent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection = Connection(int(arguments[0]))
    try:
        prepare_jax()
        _learn(connection, json.loads(connection.recv_bytes()))
    except HitchError as error:
        connection.send_bytes(json.dumps({"error": str(error)}).encode() + b"\n")
    except (EOFError, OSError):
        return


def _learn(connection: Connection, given: dict[str, Any]) -> None:
    settings = {**given["settings"], "parameters": tuple(given["settings"]["parameters"])}
    adapter = Adapter(load(given["model"]), AdaptationSettings(**settings), given["load"])
    state = adapter.resumed([Event.from_json(line) for line in given["earlier"]])
    adapter.prepare()
    events: tuple[Event, ...] = ()
    while True:
        header = {
            "changes": {direction: list(changes) for direction, changes in state.changes.items()},
            "bands": state.band_factors,
            "events": [event.to_json() for event in events],
        }
        # Computed here: where the model runs it would make a sample wait.
        numbers = np.asarray(numbers_of_models(adapter.adapted(state)))
        connection.send_bytes(json.dumps(header).encode() + b"\n" + numbers.tobytes())
        message = connection.recv_bytes()
        if message.startswith(b"rollback "):
            state, event = adapter.rollback(state, message.removeprefix(b"rollback ").decode())
            events = (event,)
        else:
            state, events = adapter.learn(state, stroke_of(message))
