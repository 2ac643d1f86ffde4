"""JSON lines as a source: from standard input, a serial device, or UDP on this machine."""

import contextlib
import fcntl
import json
import math
import os
import socket
import struct
import sys
import termios
import tty
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from hitchid.errors import InputError
from hitchid.hmi.source import REQUIRED, REQUIRED_SIGNALS, Reading, signal_named

LOOPBACK = "127.0.0.1"
MOST_BYTES = 65536  # read at once, and of an unfinished line; chosen
MOST_DATAGRAMS = 1000  # taken in one tick, so that a flood, of strangers too, cannot hold up the loop; chosen
MOST_LINES_WAITING = 3  # commands that may wait in a serial port: 30 ms of them; chosen
CAN_BE_BUSY = (BlockingIOError, InterruptedError)


@runtime_checkable
class Transport(Protocol):
    """Where lines come from and go to; no call may block.

    `read` returns what has arrived, empty for nothing yet, None at the end.
    """

    def open(self) -> None: ...
    def read(self) -> bytes | None: ...
    def write(self, line: bytes) -> None: ...
    def close(self) -> None: ...


class FileTransport:
    """Standard input (no path), or a device such as a serial port, set to raw bytes and also written to."""

    def __init__(self, path: str = "", baud: int = 115_200) -> None:
        if not hasattr(termios, f"B{baud}"):
            raise InputError(f"serial: {baud} bit/s is no baud rate of this system; expected such as 115200")
        self._path, self._baud = path, baud

    def open(self) -> None:
        """Open the device.

        Raises:
            InputError: there is none, or it may not be used.
        """
        if not self._path:
            self._file = os.dup(sys.stdin.fileno())
        else:
            try:
                # Not blocking: a port whose other end is switched off would be waited for.
                self._file = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            except OSError as error:
                raise InputError(
                    f"{self._path}: cannot be opened: {error.strerror}; expected a device"
                ) from error
            if os.isatty(self._file):
                tty.setraw(self._file)
                attributes = termios.tcgetattr(self._file)
                attributes[4] = attributes[5] = getattr(termios, f"B{self._baud}")  # input and output speed
                termios.tcsetattr(self._file, termios.TCSANOW, attributes)
        os.set_blocking(self._file, False)

    def read(self) -> bytes | None:
        """Return the bytes that have arrived."""
        try:
            return os.read(self._file, MOST_BYTES) or None
        except CAN_BE_BUSY:
            return b""
        except OSError:  # the other end of a terminal has gone
            return None

    def write(self, line: bytes) -> None:
        """Send one line to the device; standard input takes none."""
        if not self._path:
            return
        if os.isatty(self._file):
            (waiting,) = struct.unpack("i", fcntl.ioctl(self._file, termios.TIOCOUTQ, b"\0\0\0\0"))
            if waiting > MOST_LINES_WAITING * len(line):
                termios.tcflush(self._file, termios.TCOFLUSH)  # or the zero to come would queue behind it
                raise InputError(f"{self._path}: takes commands slower than they come; raise its baud rate")
        if os.write(self._file, line) != len(line):
            raise InputError(f"{self._path}: took a part of a command only; raise its baud rate")

    def close(self) -> None:
        """Close the device."""
        os.close(self._file)


class UdpTransport:
    """UDP on the loopback interface; the first sender is heard and answered, no other until `close`."""

    def __init__(self, port: int) -> None:
        self._port = port

    def open(self) -> None:
        """Listen.

        Raises:
            InputError: the port is taken.
        """
        self._sender: tuple[str, int] | None = None  # of this session: it may be another one next time
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((LOOPBACK, self._port))
        except OSError as error:
            raise InputError(f"udp port {self._port}: {error.strerror}; choose a free port") from error

    def read(self) -> bytes | None:
        """Return the datagrams that have arrived, each ended by a line feed."""
        lines = b""
        with contextlib.suppress(*CAN_BE_BUSY):
            for _ in range(MOST_DATAGRAMS):
                if len(lines) >= MOST_BYTES:
                    break
                data, sender = self._socket.recvfrom(MOST_BYTES)
                self._sender = self._sender or sender
                lines += data + b"\n" if sender == self._sender else b""
        return lines

    def write(self, line: bytes) -> None:
        """Send one datagram."""
        if self._sender is not None:
            self._socket.sendto(line, self._sender)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class JsonLines:
    """Lines like `{"time_s": 0.01, "lifting_command": 0.5, "lowering_command": 0, "displacement": 120.1}`.

    With commands allowed every tick sends `{"lifting_command": 0.5, "lowering_command": 0}`. Lines that are
    not understood, and samples whose time does not rise, are left out.

    Args:
        transport: of the lines.
        label: for the operator.
        can_move: whether commands are sent.
    """

    signals = REQUIRED_SIGNALS
    step_s = 0.01
    virtual = False

    def __init__(self, transport: Transport, label: str, *, can_move: bool = False) -> None:
        self._transport, self.label, self.can_move = transport, label, can_move

    def use_units(self, units: Sequence[str]) -> None:
        """Take the units of the signals, which lines do not carry; none keep A and mm."""
        if units:
            self.signals = tuple(
                signal_named(signal.name, unit, signal.group)
                for signal, unit in zip(self.signals, units, strict=True)
            )

    def open(self) -> None:
        """Connect."""
        self._transport.open()
        self._pending, self._latest_s = b"", -math.inf

    def read(self) -> Sequence[Reading]:
        """Return the samples that have arrived.

        Raises:
            InputError: the input has ended.
        """
        data = self._transport.read()
        if data is None:
            raise InputError(f"{self.label}: the input has ended; connect again when it is back")
        *lines, self._pending = (self._pending + data).split(b"\n")
        self._pending = self._pending[-MOST_BYTES:]  # a line without an end must not fill the memory
        return tuple(filter(None, map(self._reading, lines)))

    def write(self, commands: np.ndarray) -> None:
        """Send the commands, where they are allowed."""
        if self.can_move:
            values = dict(zip(REQUIRED[:2], map(float, commands), strict=True))
            self._transport.write(f"{json.dumps(values)}\n".encode())

    def close(self) -> None:
        """Disconnect."""
        self._transport.close()

    def _reading(self, line: bytes) -> Reading | None:
        try:
            content = json.loads(line)
        except (ValueError, RecursionError):
            return None
        if not isinstance(content, dict):
            return None
        time_s = _number(content.get("time_s"))
        # Also no number: logs and the clock of a run need times that rise.
        if not time_s > self._latest_s or math.isinf(time_s):
            return None
        self._latest_s = time_s
        return Reading(time_s, tuple(_number(content.get(signal.name)) for signal in self.signals))


def _number(value: object) -> float:
    """Return a finite number, NaN for anything else."""
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:
        return float(value)
    return math.nan
