"""The change log as a file: a line with the digest of its model, then a line for each event."""

import json
from pathlib import Path

from hitchid._support import checks
from hitchid.adaptation.events import Event
from hitchid.errors import InputError
from hitchid.model import Hitch

DIGEST = "model"  # key of the first line; change logs of earlier versions have no such line


def digest_line(model: Hitch) -> str:
    """Return the first line of the change log of a model; empty of a model that was never saved."""
    digest = model.provenance.digest
    return json.dumps({DIGEST: digest}) + "\n" if digest else ""


def read_events(path: str | Path, model: Hitch | None = None) -> tuple[Event, ...]:
    """Return the entries of a change log; a last line that was cut short is left out.

    Args:
        path: of the file.
        model: whose change log it must be; any model where None.

    Raises:
        InputError: the file cannot be read, a line is no entry, or it is the change log of another model.
    """
    file = checks.path(path, "path")
    try:
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read: {error}") from error
    events = []
    for number, line in enumerate(lines, 1):
        try:
            if number == 1 and DIGEST in (content := json.loads(line)):
                _check_model(file, content[DIGEST], model)
            else:
                events.append(Event.from_json(line))
        except (ValueError, KeyError, TypeError) as error:
            if number == len(lines) and not line.endswith("\n"):
                break
            raise InputError(f"{file}, line {number}: is no entry of a change log: {error}") from error
    return tuple(events)


def _check_model(file: Path, digest: str, model: Hitch | None) -> None:
    expected = "" if model is None else model.provenance.digest
    if expected and digest != expected:
        raise InputError(
            f"{file}: is the change log of another model: got digest {digest:.12}, expected {expected:.12}; "
            "give the change log of this model, or a new file"
        )
