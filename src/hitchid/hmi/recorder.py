"""Recorder: appends every sample to a CSV log that is readable at any time."""

import contextlib
import os
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path

from hitchid.errors import OutputError
from hitchid.hmi.source import Reading, Signal

FLUSH_S = 0.2  # s, longest time that samples wait before they are handed to the system; chosen
DIGITS = 10  # significant, of each value: below the rounding of any sensor


class Recorder:
    """A log that is being written; whole lines are appended, so that it can be read after any interruption.

    Args:
        path: of the log; it must not exist.
        signals: of the source.

    Raises:
        OutputError: the file exists, or cannot be written.
    """

    def __init__(self, path: Path, signals: Sequence[Signal]) -> None:
        self.path, self.samples = path, 0
        self._pending: list[str] = []
        self._flushed_s = self._begin_s = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o644)
            header = ",".join(["time_s", *(signal.column for signal in signals)])
            os.write(self._file, f"{header}\n".encode())
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}; choose another name") from error

    def append(self, readings: Iterable[Reading]) -> None:
        """Append samples; their time starts at zero.

        Raises:
            OutputError: the disk is full or fails.
        """
        for reading in readings:
            if self._begin_s is None or self._flushed_s is None:
                self._begin_s = self._flushed_s = reading.time_s
            cells = (reading.time_s - self._begin_s, *reading.values)
            self._pending.append(",".join(_cell(value) for value in cells))
            self.samples += 1
            if reading.time_s - self._flushed_s >= FLUSH_S:
                self._flush()
                self._flushed_s = reading.time_s

    def close(self) -> None:
        """Write what waits, and hand the log to the disk, which nobody waits for.

        Raises:
            OutputError: the disk is full or fails.
        """
        try:
            self._flush()
        finally:
            threading.Thread(target=_sync, args=(self._file,)).start()

    def _flush(self) -> None:
        if not self._pending:
            return
        data = memoryview("".join(f"{line}\n" for line in self._pending).encode())
        self._pending.clear()
        whole = os.fstat(self._file).st_size
        try:
            while data:
                data = data[os.write(self._file, data) :]
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, whole)  # of a line that did not fit
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from error


def _sync(file: int) -> None:
    """Hand a file to the disk and close it; a disk may take longer for it than a sampling time."""
    with contextlib.suppress(OSError):
        os.fsync(file)
    os.close(file)


def _cell(value: float) -> str:
    return f"{value:.{DIGITS}g}" if value == value else ""
