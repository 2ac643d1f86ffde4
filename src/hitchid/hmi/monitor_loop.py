"""The model beside the machine: blocks of samples in, predictions out; adapted while that is on."""

import json
import math
import signal
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain
from multiprocessing.connection import Connection
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import HitchError, InputError
from hitchid.hmi.model_beside import BLOCK, NO_ADAPTATION
from hitchid.hmi.recorder import packed_rows
from hitchid.hmi.source import is_same_sampling_time
from hitchid.live import ChangeLog, Changes, Event, Monitor, OnlineAdaptation
from hitchid.live.events import AT_LIMIT, CHANGE_DETECTED, FAULT, LEARNED, PROMOTED, REFUSED, ROLLED_BACK
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT, conversion_factor
from hitchid.model import Hitch, load, save

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


FREE_RUN, AHEAD = 1, 2  # kinds of messages to the page
HORIZON_S = 1.0  # s of the prediction ahead
BLOCK_S = 0.04  # s of samples that are predicted at once
LONGEST_GAP = 1.5  # sampling times between two samples, above which one is missing
LONGEST_FILLED_S = 10.0  # s of lost samples that adaptation counts as missing: a stroke has ended long before


class MonitorLoop:
    """A model beside a source, in the units of its commands and of its displacement.

    Raises:
        InputError: sampling time or units do not fit the model.
    """

    def __init__(self, model: Hitch, units: tuple[str, str], step_s: float) -> None:
        if not is_same_sampling_time(step_s, model.step_s):
            raise InputError(
                f"the model has a sampling time of {model.step_s:g} s, the source of {step_s:g} s; "
                "identify a model at that of the source"
            )
        command_units = {model.units[COMMAND[direction]] for direction in model.channels}
        self._command_factor = np.array([1.0, 1.0])
        for number, direction in enumerate(DIRECTIONS):
            unit = model.units.get(COMMAND[direction], next(iter(command_units)))
            self._command_factor[number] = conversion_factor(units[0], unit, COMMAND[direction])
        self._factor = conversion_factor(units[1], model.units[DISPLACEMENT], DISPLACEMENT)
        self._identified, self._step_s = model, step_s
        self._block = max(1, round(BLOCK_S / step_s))
        self._monitor: Monitor | None = None
        self._is_running = False
        self._waiting, self._latest_s = np.empty((0, 4)), np.inf  # infinite: no gap before the first sample
        self._adaptation: ModelAdaptation | None = None
        self._reason, self._is_told = "", True

    @property
    def adaptation(self) -> ModelAdaptation:
        """The adaptation.

        Raises:
            InputError: the model is not adapted.
        """
        if self._adaptation is None:
            raise InputError("the model is not adapted; switch adaptation on first")
        return self._adaptation

    def restart(self) -> None:
        """Start the free run anew at the next measured displacement."""
        self._is_running = False

    def adapt(self, path: Path | None) -> None:
        """Begin to adapt the model with a change log, or end it: the model is then the identified one again.

        Raises:
            InputError, OutputError: the change log is none, or cannot be written.
        """
        if self._adaptation is not None:
            # The model first: ending waits for what is being learned, which is of no use any more.
            ended, self._adaptation = self._adaptation, None
            self._adjust()
            ended.end()
        if path is not None:
            factors: dict[str, float] = dict(zip(DIRECTIONS, self._command_factor.tolist(), strict=True))
            self._adaptation = ModelAdaptation(self._identified, path, factors)
        self._reason, self._is_told = "", False

    def news_of_adaptation(self) -> Mapping[str, object] | None:
        """Return what the page shows of the adaptation, where that differs from what was told before."""
        if self._is_told:
            return None
        self._is_told = True
        if self._adaptation is None:
            return {**NO_ADAPTATION, "reason": self._reason}
        return self._adaptation.describe()

    def advance(self, rows: np.ndarray) -> list[tuple[int, np.ndarray]]:
        """Return kind and rows of the predictions that samples complete; time, displacement, band.

        Samples are time, s; lifting command, lowering command, displacement; shape [N, 4].
        """
        gaps = np.diff(rows[:, 0], prepend=self._latest_s) > LONGEST_GAP * self._step_s
        messages = []
        for number, piece in enumerate(np.split(rows, np.flatnonzero(gaps))):
            if number:
                self.restart()  # samples were lost on the way here, so that the free run would lack commands
                self._waiting = rows[:0]
                # Adaptation counts them as missing, as many as a stroke needs to end.
                begin_s = piece[0, 0]
                lost = min(begin_s - self._latest_s, LONGEST_FILLED_S)
                count = max(0, round(lost / self._step_s) - 1)
                times = begin_s - self._step_s * np.arange(count, 0, -1)
                self._learn(np.column_stack([times, np.full((count, 3), np.nan)]))
            self._waiting = np.concatenate([self._waiting, piece])
            while len(self._waiting) >= self._block:
                block, self._waiting = self._waiting[: self._block], self._waiting[self._block :]
                messages += self._predict(block)
            self._learn(piece)
            self._latest_s = piece[-1, 0] if len(piece) else self._latest_s
        return messages

    def _predict(self, block: np.ndarray) -> list[tuple[int, np.ndarray]]:
        commands, measured = self._in_model_units(block)
        if not self._is_running and not np.isfinite(measured[0]):
            return []  # nowhere to start from
        if self._monitor is None:
            self._monitor = Monitor(self._identified, measured[0], block=self._block, horizon_s=HORIZON_S)
            self._monitor.adjust(self._model)  # made of the identified one, whose program stays
        elif not self._is_running:
            self._monitor.restart(measured[0])
        self._is_running = True
        predicted = self._monitor.advance(commands, measured)
        free_run = np.column_stack([predicted.free_run, predicted.free_run_half_width]) / self._factor
        ahead = np.array([[predicted.ahead, predicted.ahead_half_width]]) / self._factor
        ahead_s = block[-1:, 0] + self._monitor.horizon * self._step_s
        return [(FREE_RUN, _with_band(block[:, 0], free_run)), (AHEAD, _with_band(ahead_s, ahead))]

    def _learn(self, rows: np.ndarray) -> None:
        """Learn from samples; where that fails the model is the identified one again."""
        if self._adaptation is None or not len(rows):
            return
        try:
            has_started = self._adaptation.start()
            has_learned = self._adaptation.feed(float(rows[0, 0]), *self._in_model_units(rows))
        except HitchError as error:
            self.adapt(None)
            self._reason = str(error)
            return
        if has_started or has_learned:
            self._adjust()

    def _adjust(self) -> None:
        """Go on with the model in use."""
        self._is_told = False
        if self._monitor is not None:
            self._monitor.adjust(self._model)

    @property
    def _model(self) -> Hitch:
        """The model in use."""
        adapted = None if self._adaptation is None else self._adaptation.model
        return self._identified if adapted is None else adapted

    def _in_model_units(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return commands and displacement of samples in the model's units."""
        return self._command_factor * rows[:, 1:3], self._factor * rows[:, 3]


def _with_band(time_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return time, displacement, lower and upper limit from displacement and half width."""
    centre, half_width = rows.T
    return np.column_stack([time_s, centre, centre - half_width, centre + half_width])


# The process of the model beside the machine: samples and requests in, predictions and replies out.

MOST_WAITING = 100  # messages with samples before the oldest is dropped: four seconds of them; chosen
COLUMNS = 5  # of a sample: wall clock, ms; time, s; both commands, displacement


def main(arguments: Sequence[str]) -> None:
    """Predict until the server is gone, given the file descriptor of the connection and settings as JSON."""
    from hitchid._support.jax_setup import prepare_jax

    # Ctrl-C ends the server, which ends this process: the change log is closed in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection, settings = Connection(int(arguments[0])), json.loads(arguments[1])
    loop = None
    try:
        prepare_jax()
        loop = MonitorLoop(load(Path(settings["model"])), tuple(settings["units"]), settings["step_s"])
        waiting: deque[bytes] = deque(maxlen=MOST_WAITING)
        while True:
            _proceed(loop, connection, waiting)
            if (news := loop.news_of_adaptation()) is not None:
                connection.send_bytes(json.dumps({"type": "adaptation", **news}).encode())
    except HitchError as error:
        connection.send_bytes(json.dumps({"type": "error", "error": str(error)}).encode())
    except (EOFError, OSError):
        pass
    finally:
        if loop is not None:
            loop.adapt(None)


def _proceed(loop: MonitorLoop, connection: Connection, waiting: deque[bytes]) -> None:
    """Take a message: a request is answered at once, samples are predicted when no message is left."""
    # Else a button would wait for the predictions of seconds that have piled up.
    if waiting and not connection.poll():
        rows = np.frombuffer(waiting.popleft()[len(BLOCK) :]).reshape(-1, COLUMNS)
        for kind, predicted in loop.advance(rows[:, 1:]):
            connection.send_bytes(packed_rows(kind, predicted, rows[-1, 0]))
        return
    message = connection.recv_bytes()
    if message.startswith(BLOCK):
        waiting.append(message)
        return
    request, error = json.loads(message), None
    try:
        match request["type"]:
            case "monitor_restart":
                loop.restart()
            case "adapt":
                loop.adapt(Path(request["log"]) if request["on"] else None)
            case "roll_back":
                loop.adaptation.roll_back(request["direction"])
            case "save_adapted":
                loop.adaptation.save(Path(request["folder"]))
            case kind:
                raise InputError(f"{kind!r:.40} is no request to the model beside the machine")
    except HitchError as problem:
        error = str(problem)
    is_written = error is None and request["type"] == "save_adapted"
    reply = {"type": "reply", "id": request["id"], "error": error, "written": is_written}
    connection.send_bytes(json.dumps(reply).encode())
