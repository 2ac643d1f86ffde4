"""Recorder: appends every sample to a CSV log that is readable at any time."""

import contextlib
import os
import threading
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from hitchid.errors import OutputError
from hitchid.hmi import project
from hitchid.hmi.disk import Disk
from hitchid.hmi.source import Reading, Signal

# The samples of the last hour, in memory that is reserved at once.

SPEED_SPAN_S = 0.1  # s; chosen: the noise of a sensor of 0.05 mm is 0.7 mm/s then
HISTORY_S = 3600.0  # s that are kept; older samples are in the logs; chosen


class History:
    """Samples of a source in the order of time, which is their first column, s."""

    def __init__(self, columns: int, step_s: float) -> None:
        self._rows = np.full((max(1, round(HISTORY_S / step_s)), columns), np.nan)
        self.columns, self._count = columns, 0

    def append(self, rows: np.ndarray) -> None:
        """Append samples, shape [N, columns]; the oldest are overwritten."""
        slots = (self._count + np.arange(len(rows))) % len(self._rows)
        self._rows[slots] = rows
        self._count += len(rows)

    def decimated(self, begin_s: float, end_s: float, points: int) -> np.ndarray:
        """Return lowest and highest value of each signal in equal bins, or every sample where it fits.

        Of an interval at most `points` rows, shape [M, columns]; a bin gives two at its ends.
        """
        is_full = self._count > len(self._rows)
        oldest = self._count % len(self._rows)
        rows = np.roll(self._rows, -oldest, axis=0) if is_full else self._rows[: self._count]
        first, last = np.searchsorted(rows[:, 0], [begin_s, end_s], side="left")
        inside = rows[first : last + (last < len(rows) and rows[last, 0] == end_s)]
        if len(inside) <= points:
            return inside
        edges = np.linspace(0, len(inside), max(1, points // 2) + 1).astype(int)
        extremes = np.empty((2 * (len(edges) - 1), inside.shape[1]))
        # A bin that lacks some values still has a lowest and a highest of the others.
        extremes[::2] = np.fmin.reduceat(inside, edges[:-1])
        extremes[1::2] = np.fmax.reduceat(inside, edges[:-1])
        extremes[::2, 0], extremes[1::2, 0] = inside[edges[:-1], 0], inside[edges[1:] - 1, 0]
        return extremes


class SpeedEstimate:
    """Speed from one column of the samples, by its difference over a tenth of a second."""

    def __init__(self, column: int, step_s: float) -> None:
        self._column = column
        self._span = max(1, round(SPEED_SPAN_S / step_s))
        self._before: np.ndarray | None = None

    def advance(self, rows: np.ndarray) -> np.ndarray:
        """Return the speed at each of the next samples, in the displacement's unit a second, shape [N]."""
        pairs = rows[:, [0, self._column]]
        if self._before is None:
            # As if it had rested before: the speed at the start is zero, not that from nowhere.
            self._before = np.repeat(pairs[:1], self._span, axis=0)
        recent = np.concatenate([self._before, pairs])
        self._before = recent[-self._span :]
        elapsed_s, travel = (recent[self._span :] - recent[: -self._span]).T
        return np.divide(travel, elapsed_s, out=np.zeros(len(rows)), where=elapsed_s > 0)


def packed_rows(kind: int, rows: np.ndarray, wall_ms: float) -> bytes:
    """Return samples as the page reads them: four unsigned numbers, the wall clock, the rows."""
    header = np.array([kind, *rows.shape, 0], "<u4").tobytes() + np.array([wall_ms], "<f8").tobytes()
    return header + np.ascontiguousarray(rows, "<f8").tobytes()


def block_of(message: bytes) -> tuple[float, np.ndarray]:
    """Return wall clock, ms, and rows of a block of the bench loop."""
    numbers = np.frombuffer(message, dtype=float)
    return float(numbers[0]), numbers[2:].reshape(-1, int(numbers[1]))


FLUSH_S = 0.2  # s, longest time that samples wait before they are handed to the disk; chosen
DIGITS = 10  # significant, of each value: below the rounding of any sensor


class Recorder:
    """A log that is being written; whole lines are appended, so that it can be read after any interruption.

    No call waits for the disk that the log is handed to; what goes wrong there, such as a log that exists, is
    told by `Disk.check`. Its path is relative to the project.
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
            if self._begin_s is None or self._flushed_s is None:  # zero of the log
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
            project.place(root, path)
            # Made here or not at all: another log of this name may have come since it was looked for.
            self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}; choose another name") from error
        try:
            self._write(header)
        except OutputError:
            self._close()
            self.path.unlink(missing_ok=True)  # an empty log would only keep its name from being used
            raise

    def _write(self, data: bytes) -> None:
        if self._file is None:  # could not be opened, which was told
            return
        rest, whole = memoryview(data), os.fstat(self._file).st_size
        try:
            while rest:
                rest = rest[os.write(self._file, rest) :]  # which takes a part where a disk fills up
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, whole)  # a line that did not fit whole is none
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
