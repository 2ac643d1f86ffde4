"""The change log as a file: a line with the digest of its model, then a line for each event."""

import json
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from hitchid._support import checks
from hitchid.adaptation.events import Event
from hitchid.errors import InputError
from hitchid.model import Hitch

MAX_LINE_BYTES = (
    1 << 16
)  # of an entry, a hundred times its usual length; another file must not fill the memory


class _First(BaseModel):
    """First line of a change log; logs of earlier versions have none."""

    model_config = ConfigDict(extra="forbid", strict=True)

    model: str


def digest_line(model: Hitch) -> str:
    """Return the first line of the change log of a model; empty of a model that was never saved."""
    digest = model.provenance.digest
    return json.dumps({"model": digest}) + "\n" if digest else ""


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
    _check_order(file, events)
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
    place = ".".join(map(str, first["loc"]))
    return f"{place}: {first['msg']}" if place else first["msg"]


def _check_order(file: Path, events: list[Event]) -> None:
    """Check that the strokes are in the order of their time: two writers at once would mix two histories."""
    latest_s = 0.0
    for event in events:
        if event.stroke and event.time_s < latest_s:
            raise InputError(
                f"{file}: is not the change log of one run after the other: an entry of {event.time_s:g} s "
                f"follows one of {latest_s:g} s; use a new file"
            )
        latest_s = max(latest_s, event.time_s if event.stroke else 0.0)
