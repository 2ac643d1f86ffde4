"""The change log of an adaptation that runs, as a file to which each event is added at once."""

import contextlib
import errno
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from scipy.special import stdtrit

from hitchid._support import checks
from hitchid._support.records import short_repr
from hitchid.errors import InputError, OutputError
from hitchid.live.events import LEARNED, Event
from hitchid.model import Hitch

# The change log as a file: a line with the digest of its model, then a line for each event.

# Of an entry, a hundred times its usual length; another file must not fill the memory.
MAX_LINE_BYTES = 1 << 16


class _First(BaseModel):
    """First line of a change log; logs of earlier versions have none."""

    model_config = ConfigDict(extra="forbid", strict=True)

    model: str


def read_events(path: str | Path, model: Hitch | None = None) -> tuple[Event, ...]:
    """Return the entries of a change log; a last line that was cut short is left out.

    Args:
        path: of the file.
        model: whose change log it must be; any model where None.

    Raises:
        InputError: the file cannot be read, a line is no entry, the time goes back, or it is the change log
            of another model.
    """
    return read_log(path, model)[0]


def read_log(path: str | Path, model: Hitch | None = None) -> tuple[tuple[Event, ...], int]:
    """Return the entries of a change log as `read_events`, and the bytes up to the end of the last one."""
    file = checks.path(path, "path")
    events: list[Event] = []
    size = number = 0
    try:
        if file.exists() and not file.is_file():  # a pipe may never end
            raise InputError(f"{file}: cannot be read: expected a file")
        with file.open("rb") as content:
            while line := content.readline(MAX_LINE_BYTES + 1):
                number += 1
                try:
                    events += _entries(line, number, file, model)
                except ValueError as error:
                    if not line.endswith(b"\n") and len(line) <= MAX_LINE_BYTES:
                        break  # cut short: no part of an entry is one itself
                    raise InputError(
                        f"{file}, line {number}: is no entry of a change log: {_reason(error)}"
                    ) from error
                size += len(line)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
    latest_s = 0.0
    for event in events:  # two writers at once would mix two histories
        if event.stroke and event.time_s < latest_s:
            raise InputError(
                f"{file}: is not the change log of one run after the other: an entry of {event.time_s:g} s "
                f"follows one of {latest_s:g} s; use a new file"
            )
        latest_s = max(latest_s, event.time_s if event.stroke else 0.0)
    return tuple(events), size


def _entries(line: bytes, number: int, file: Path, model: Hitch | None) -> list[Event]:
    """Return the entry of a line; none of a blank line, or of the first one, which has the digest.

    Raises:
        ValueError: it is no entry.
        InputError: the digest is that of another model.
    """
    if len(line) > MAX_LINE_BYTES:
        raise ValueError(f"is longer than {MAX_LINE_BYTES} bytes")
    if not line.strip():
        return []
    if number > 1 or b'"model"' not in line[:10]:
        return [Event.from_json(line)]
    digest = _First.model_validate_json(line).model
    expected = "" if model is None else model.provenance.digest
    if expected and digest != expected:
        raise InputError(
            f"{file}: is the change log of another model: got digest {digest:.12}, expected {expected:.12}; "
            "give the change log of this model, or a new file"
        )
    return []


def _reason(error: ValueError) -> str:
    """Return the first fault that was found, and where in the entry."""
    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors(include_url=False)[0]
    key = ".".join(map(str, first["loc"]))
    return f"{key}: {first['msg']}" if key else first["msg"]


# Wear: slow trends of gain, dead zone and leak in a change log, and when they reach a limit.

FEWEST = 5  # estimates from which a trend is fitted; chosen
STROKES_APART = 8  # of a direction between two estimates, so that they share no stroke: the window's length
PARAMETERS, LEAK = ("gain", "dead_zone"), "leak"


@short_repr
@dataclass(frozen=True)
class Trend:
    """Slope of one parameter over time.

    Attributes:
        direction: of the channel; empty of the leak.
        parameter: `gain`, the logarithm of the factor on it; `dead_zone`, what is added to it; `leak`, speed
            of the piston at standstill, negative where it sinks.
        per_hour: slope, 1/h of the gain, the command's unit/h of the dead zone, the displacement's unit/s/h
            of the leak.
        interval: 95 % interval of the slope.
        value: at the last estimate, on the line.
        limit_after_h: hours from the last estimate until a limit is reached: earliest within the interval of
            the slope, with the slope itself, and latest; infinite where it may stay.
    """

    direction: str
    parameter: str
    per_hour: float
    interval: tuple[float, float]
    value: float
    limit_after_h: tuple[float, float, float]

    @property
    def significant(self) -> bool:
        """Whether the interval of the slope excludes zero."""
        return self.interval[0] > 0 or self.interval[1] < 0


def trends(events: Sequence[Event], limits: Mapping[str, float]) -> tuple[Trend, ...]:
    """Return the trend of each parameter of each direction, by weighted least squares of a straight line.

    With estimates y(i) ± σ(i) at times t(i), weights 1/σ² and the scatter about the line, the slope has the
    standard error of a regression with n − 2 degrees of freedom. Estimates of gain and dead zone are at least
    eight strokes apart; those of the leak are of one standstill each.

    Args:
        events: change log, of one start of the adaptation.
        limits: parameter to its largest value either way: logarithm for the gain, the command's unit for the
            dead zone, the displacement's unit/s for the leak; one that is missing has no limit.

    Raises:
        InputError: an entry lacks a figure, or has a standard deviation that is not positive.
    """
    learned = [event for event in events if event.kind == LEARNED]
    made = []
    for direction in dict.fromkeys(event.direction for event in learned):
        # From the latest backwards: the newest estimate says most of what comes.
        apart = [event for event in learned if event.direction == direction][::-1][::STROKES_APART][::-1]
        if len(apart) >= FEWEST:
            made += [_trend(direction, parameter, apart, limits) for parameter in PARAMETERS]
    rested = [event for event in events if LEAK in event.figures]
    if len(rested) >= FEWEST:
        made.append(_trend("", LEAK, rested, limits))
    return tuple(made)


def _trend(direction: str, parameter: str, events: Sequence[Event], limits: Mapping[str, float]) -> Trend:
    for event in events:
        if parameter not in event.figures or not event.figures.get(f"{parameter}_deviation", 0.0) > 0:
            raise InputError(
                f"events: '{event.kind}' at {event.time_s:g} s: expected the figures {parameter}, and "
                f"{parameter}_deviation above 0"
            )
    hours = np.array([event.time_s for event in events]) / 3600
    values, deviations = (
        np.array([event.figures[name] for event in events]) for name in (parameter, f"{parameter}_deviation")
    )
    weights = 1 / deviations**2
    # About their weighted mean, where slope and mean are independent of each other.
    centred = hours - np.average(hours, weights=weights)
    spread = float(np.sum(weights * centred**2))
    slope = float(np.sum(weights * centred * values)) / spread
    mean = float(np.average(values, weights=weights))
    left = values - mean - slope * centred
    # Strokes that scatter less than their deviations say make the slope no more certain: at least one.
    variance = max(1.0, float(np.sum(weights * left**2)) / (len(values) - 2)) / spread
    half_width = float(stdtrit(len(values) - 2, 0.975)) * float(np.sqrt(variance))
    value = mean + slope * float(centred[-1])
    ends = slope - half_width, slope + half_width
    limit = limits.get(parameter, float("inf"))
    low, expected, high = (_hours_to_limit(value, rate, limit) for rate in (ends[0], slope, ends[1]))
    earliest, latest = min(low, expected, high), max(low, expected, high)
    if ends[0] <= 0 <= ends[1]:  # it may as well stay
        latest = float("inf")
    return Trend(direction, parameter, slope, ends, value, (earliest, expected, latest))


def _hours_to_limit(value: float, per_hour: float, limit: float) -> float:
    """Return the hours until a value reaches plus or minus a limit; infinite where it stays."""
    if per_hour == 0:
        return float("inf")
    return max(0.0, (np.copysign(limit, per_hour) - value) / per_hour)


class ChangeLog:
    """A change log that goes on from an existing one, and that no other process writes meanwhile.

    Its first line is the digest of its model, so that it is not gone on from with another one. It is made
    where there is none, and removed at the end where nothing happened.

    Attributes:
        earlier: events that it had before.

    Raises:
        InputError: an existing file is no change log, or that of another model.
        OutputError: it cannot be written, or another process writes it.
    """

    def __init__(self, path: Path, model: Hitch) -> None:
        self._path, digest = path, model.provenance.digest
        self._first = json.dumps({"model": digest}) + "\n" if digest else ""  # none if it was never saved
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be a change log: expected a file")
        # Innermost first, so that they can be removed again one after the other.
        self._made = (
            [] if path.exists() else [path, *(folder for folder in path.parents if not folder.exists())]
        )
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise self._failure(error) from error
        try:
            self._lock()
            # Read before anything of it is changed.
            self.earlier, size = read_log(path, model)
            self._file.seek(self._file.truncate(size))  # without a last line that was cut short
            with path.open("rb") as existing:
                existing.seek(max(size - 1, 0))
                ends_line = existing.read() == b"\n"
            if size and not ends_line:
                self._append(b"\n")
        except OSError as error:
            self._file.close()
            raise self._failure(error) from error
        except BaseException:
            self._file.close()
            raise

    def write(self, event: Event) -> None:
        """Add an event.

        Raises:
            OutputError: it cannot be written.
        """
        first = "" if self._file.tell() else self._first  # only with an entry: an empty log leaves no file
        try:
            self._append(f"{first}{event.to_json()}\n".encode())
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Close the file; one that was made, and the folders for it, are removed where nothing happened."""
        if self._made and not self._file.tell():
            file, *folders = self._made
            file.unlink(missing_ok=True)  # before the lock is given up: another process may wait for it
            with contextlib.suppress(OSError):  # another program has put something into a folder
                for folder in folders:
                    folder.rmdir()
        self._file.close()

    def _append(self, line: bytes) -> None:
        """Add a line whole or not at all."""
        before = self._file.tell()
        try:
            if self._file.write(line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            with contextlib.suppress(OSError):
                self._file.seek(self._file.truncate(before))
            raise

    def _lock(self) -> None:
        """Let no other process write the file until this one closes it or ends; Windows has no such lock.

        Raises:
            OutputError: another process writes it.
        """
        with contextlib.suppress(ImportError):
            import fcntl

            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # Its last writer may just have removed it: what is written then would be in no folder.
                is_there = os.path.samestat(os.fstat(self._file.fileno()), os.stat(self._path))
            except (BlockingIOError, FileNotFoundError):
                is_there = False  # another process has it, or has just removed it
            if not is_there:
                raise OutputError(
                    f"{self._path}: another process writes this change log; end it, or give another file"
                )

    def _failure(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path}: cannot be written: {error.strerror}")
