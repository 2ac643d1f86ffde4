"""Commands on logs alone."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid.cli.options import AsJson, Force, Logs, Signals
from hitchid.errors import InputError

if TYPE_CHECKING:
    from hitchid.inspection import Inspection

PICTURES = (".png", ".svg", ".pdf")


def inspect(
    logs: Logs,
    signals: Signals = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model folder that knows dead zones and dead times.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--draw", help="Picture of the mixed logs to write: .png, .svg or .pdf.")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Show what logs hold: signals, units, sampling, kinds of test, what mixed logs do, faults."""
    from hitchid import display
    from hitchid.inspection import inspect as look

    if picture is not None:
        _check_picture(picture, force=force)
    switches = None
    if model is not None:
        from hitchid.model import load

        switches = load(model).switches
    found = look(logs, signals=signals, switches=switches)
    if picture is not None:
        _draw(found, picture, force=force)
    if as_json:
        typer.echo(json.dumps(found.describe(), indent=1))
    else:
        display.show_inspection(found)
    if found.faults:
        raise typer.Exit(2)


def _check_picture(path: Path, *, force: bool) -> None:
    from hitchid.storage import check_file

    if path.suffix not in PICTURES:
        raise InputError(f"--draw: required a name ending in {', '.join(PICTURES)}, came '{path.name}'")
    check_file(path, force=force)


def _draw(found: "Inspection", path: Path, *, force: bool) -> None:
    if not found.mixed:
        raise InputError("--draw: none of the logs moves both ways; there is nothing to draw")
    from hitchid.report.figures.timeline import draw

    draw(found.mixed, path, force=force)
