"""Recorder: appends every sample to a CSV log that is readable at any time."""

import contextlib
import os
import threading
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from hitchid.errors import OutputError
from hitchid.hmi import project
from hitchid.hmi.disk import Disk
from hitchid.hmi.source import Reading, Signal

FLUSH_S = 0.2  # s, longest time that samples wait before they are handed to the disk; chosen
DIGITS = 10  # significant, of each value: below the rounding of any sensor


class Recorder:
    """A log that is being written; whole lines are appended, so that it can be read after any interruption.

    No call waits for the disk; what goes wrong there is told by `Disk.check`.

    Args:
        root: folder of the project.
        path: of the log, relative to it; it must not exist.
        signals: of the source.
        disk: that the log is handed to.
    """

    def __init__(self, root: Path, path: str, signals: Sequence[Signal], disk: Disk) -> None:
        self.path, self.samples = root / path, 0
        self._disk, self._file = disk, None
        self._lines: list[str] = []
        self._flushed_s = self._begin_s = None
        header = ",".join(["time_s", *(signal.column for signal in signals)])
        disk.put(partial(self._open, root, path, f"{header}\n".encode()))

    def append(self, readings: Iterable[Reading]) -> None:
        """Append samples; their time starts at zero."""
        for reading in readings:
            if self._begin_s is None or self._flushed_s is None:
                self._begin_s = self._flushed_s = reading.time_s
            cells = (reading.time_s - self._begin_s, *reading.values)
            self._lines.append(",".join(map(_cell, cells)) + "\n")
            self.samples += 1
            if reading.time_s - self._flushed_s >= FLUSH_S:
                self._flush()
                self._flushed_s = reading.time_s

    def close(self) -> None:
        """Hand over what is left, and end the log."""
        self._flush()
        self._disk.put(self._close)

    def _flush(self) -> None:
        if self._lines:
            self._disk.put(partial(self._write, "".join(self._lines).encode()))
            self._lines.clear()

    def _open(self, root: Path, path: str, header: bytes) -> None:
        try:
            place = project.place(root, path)
            self._file = os.open(place, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}; choose another name") from error
        try:
            self._write(header)
        except OutputError:
            self._close()
            place.unlink(missing_ok=True)  # an empty log would only keep its name from being used
            raise

    def _write(self, data: bytes) -> None:
        if self._file is None:  # could not be opened, which was told
            return
        rest, whole = memoryview(data), os.fstat(self._file).st_size
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, whole)  # of a line that did not fit
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from error

    def _close(self) -> None:
        if self._file is not None:
            # In a thread of its own: the next log must not wait until this one has reached the disk.
            threading.Thread(target=_sync, args=(self._file,), daemon=True).start()
            self._file = None


def _sync(file: int) -> None:
    with contextlib.suppress(OSError):
        os.fsync(file)
    os.close(file)


def _cell(value: float) -> str:
    return f"{value:.{DIGITS}g}" if value == value else ""
