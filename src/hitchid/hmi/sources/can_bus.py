"""A CAN bus with a DBC as a source; needs hitchid[can]."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from hitchid.errors import InputError
from hitchid.hmi.source import REQUIRED, Reading, signal_named
from hitchid.logs import StrictSettings, parse_settings

HELD_S = 0.1  # s, age at which a value counts as missing, not as measured again; chosen: a slow cycle time
MOST_FRAMES = 1000  # taken in one tick, so that a flooded bus cannot hold up the loop; chosen
GROUPS = {"displacement": "displacement", "lifting_command": "command", "lowering_command": "command"}


class OutputMessage(StrictSettings):
    """`[output]`: the message that carries the commands, sent each tick."""

    message: str
    lifting_command: str
    lowering_command: str


class BusFile(StrictSettings):
    """The file of a CAN source.

    Attributes:
        interface: of python-can, such as socketcan.
        channel: of the interface, such as can0.
        database: DBC file, relative to this file.
        step_s: sampling time, s.
        signals: name to `Message/Signal`; at least both commands and the displacement.
        output: message of the commands; none where nothing may be moved.
    """

    interface: str = "socketcan"
    channel: str
    database: str
    step_s: float = Field(default=0.01, gt=0)
    signals: dict[str, str]
    output: OutputMessage | None = None


class CanBus:
    """The newest values of signals on a CAN bus, sampled each tick; see `BusFile`."""

    virtual = False

    def __init__(self, path: str) -> None:
        self._settings = parse_settings(Path(path), BusFile)
        missing = [name for name in REQUIRED if name not in self._settings.signals]
        if missing:
            raise InputError(
                f"{path}: signals lacks {', '.join(missing)}; expected 'Message/Signal' for each"
            )
        self._database = _database(Path(path).parent / self._settings.database)
        located = {name: self._located(path, text) for name, text in self._settings.signals.items()}
        names = (*REQUIRED, *(name for name in located if name not in REQUIRED))
        self.signals = tuple(
            signal_named(name, located[name][1].unit or "1", GROUPS.get(name, "other")) for name in names
        )
        self._columns: dict[int, list[tuple[int, str]]] = {}
        for column, name in enumerate(names):
            message, signal = located[name]
            self._columns.setdefault(message.frame_id, []).append((column, signal.name))
        self.label = f"CAN {self._settings.interface} {self._settings.channel}"
        self.step_s = self._settings.step_s
        output = self._settings.output
        self.can_move = output is not None
        if output is not None:
            commands = (output.lifting_command, output.lowering_command)
            sent = [self._located(path, f"{output.message}/{name}")[1].unit for name in commands]
            for role, name, unit in zip(REQUIRED[:2], commands, sent, strict=True):
                if unit != located[role][1].unit:  # they are sent as they are, in the unit that is read
                    raise InputError(f"{path}: {name} is in {unit}, {role} in {located[role][1].unit}")

    def open(self) -> None:
        """Open the bus.

        Raises:
            InputError: python-can is not installed, or the bus cannot be opened.
        """
        try:
            import can
        except ImportError as error:
            raise InputError("CAN needs python-can; install hitchid[can]") from error
        try:
            self._bus: Any = can.Bus(interface=self._settings.interface, channel=self._settings.channel)
        except Exception as error:  # drivers raise what they like
            raise InputError(f"{self.label}: cannot be opened: {error}") from error
        self._message_class = can.Message
        self._begin_s = time.monotonic()
        self._values = [math.nan] * len(self.signals)
        self._taken_s = [-math.inf] * len(self.signals)

    def read(self) -> Sequence[Reading]:
        """Return the newest values; NaN for one that was not sent for `HELD_S`.

        Raises:
            InputError: the bus is lost.
        """
        for _ in range(MOST_FRAMES):  # without waiting, until none is left: the newest values count
            frame = self._on_bus(self._bus.recv, timeout=0)
            if frame is None:
                break
            self._take(frame)
        now_s = time.monotonic()
        values = (
            value if now_s - taken_s < HELD_S else math.nan
            for value, taken_s in zip(self._values, self._taken_s, strict=True)
        )
        return (Reading(now_s - self._begin_s, tuple(values)),)

    def write(self, commands: np.ndarray) -> None:
        """Send the commands, where there is a message for them.

        Raises:
            InputError: the bus is lost.
        """
        self._on_bus(self._send, commands)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def _located(self, path: str, text: str) -> tuple[Any, Any]:
        message_name, _, signal_name = text.partition("/")
        try:
            message = self._database.get_message_by_name(message_name)
            return message, message.get_signal_by_name(signal_name)
        except KeyError as error:
            raise InputError(f"{path}: '{text}' is not in the database; expected 'Message/Signal'") from error

    def _on_bus(self, call: Callable[..., Any], *arguments: object, **named: object) -> Any:
        try:
            return call(*arguments, **named)
        except Exception as error:  # drivers raise what they like
            raise InputError(f"{self.label}: {error}; check the bus and connect again") from error

    def _send(self, commands: np.ndarray) -> None:
        output = self._settings.output
        if output is None:
            return
        message = self._database.get_message_by_name(output.message)
        # A message is sent whole: its signals that are no command are zero.
        values = dict.fromkeys((signal.name for signal in message.signals), 0.0)
        values |= {output.lifting_command: float(commands[0]), output.lowering_command: float(commands[1])}
        self._bus.send(
            self._message_class(
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                data=message.encode(values, strict=True),
            )
        )

    def _take(self, frame: Any) -> None:
        columns = self._columns.get(frame.arbitration_id)
        if not columns:
            return
        message = self._database.get_message_by_frame_id(frame.arbitration_id)
        # What a short frame lacks is missing then; it is no reason to lose the bus, and to stop a run.
        decoded = message.decode(frame.data, decode_choices=False, allow_truncated=True)
        for column, name in columns:
            self._values[column] = float(decoded.get(name, math.nan))
            self._taken_s[column] = time.monotonic()


def _database(path: Path) -> Any:
    try:
        import cantools
    except ImportError as error:
        raise InputError("a DBC needs cantools; install hitchid[can]") from error
    try:
        return cantools.database.load_file(path)
    except Exception as error:  # parsers raise what they like
        raise InputError(f"{path}: cannot be read: {error}; expected a DBC") from error
