"""`hitchid inspect`: content and audit of logs, proposal of a campaign.toml."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid.cli import options
from hitchid.errors import InputError

if TYPE_CHECKING:
    from hitchid.logs import Inspection

MAX_DRAWN = 12  # records in one picture (chosen)
PICTURES = (".png", ".svg", ".pdf")


def inspect(
    logs: options.Logs,
    signals: options.Signals = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model folder with dead zones and dead times.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--draw", help="File for a plot of mixed logs and findings: .png, .svg or .pdf."),
    ] = None,
    propose: Annotated[
        bool,
        typer.Option(
            "--propose", help="Write a proposed campaign.toml instead, with the reason for each choice."
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", help="File for --propose [standard output].")] = None,
    strict: options.Strict = False,
    force: options.Force = False,
    as_json: options.AsJson = False,
) -> None:
    """Show the content of logs and audit them: problems, where they are, and what to measure again."""
    from hitchid.cli import terminal as display
    from hitchid.logs import inspect as look
    from hitchid.logs.audit import Severity

    if out is not None and not propose:
        raise InputError("--out needs --propose")
    if propose:
        _propose(logs, out, force=force)
        return
    if picture is not None:
        if picture.suffix not in PICTURES:
            raise InputError(f"--draw: expected a name ending in {', '.join(PICTURES)}, got '{picture.name}'")
        options.check_output(picture, [*logs, signals, model], force=force)
    switches = None
    if model is not None:
        from hitchid.model import load

        switches = load(model).command_thresholds
    inspection = look(logs, signals=signals, command_thresholds=switches, strict=strict)
    if picture is not None:
        _draw(inspection, picture, force=force)
    if as_json:
        typer.echo(json.dumps(inspection.describe(), indent=1))
    else:
        display.show_inspection(inspection)
    # 2 for logs that cannot be used, 1 for those that can and would spoil a model.
    if inspection.faults:
        raise typer.Exit(2)
    if any(finding.severity is Severity.FAULT for finding in inspection.findings):
        raise typer.Exit(1)


def _propose(logs: list[Path], out: Path | None, *, force: bool) -> None:
    from hitchid._support.files import write_bytes
    from hitchid.logs import propose

    if out is not None:
        options.check_output(out, logs, force=force)
    text = propose(logs)
    if out is None:
        typer.echo(text, nl=False)
    else:
        write_bytes(out, text.encode("utf-8", errors="surrogateescape"), force=force)


def _draw(inspection: "Inspection", path: Path, *, force: bool) -> None:
    if not inspection.usable:
        raise InputError("--draw: none of the logs can be used; check the warnings")
    from hitchid.report.figures.timeline import Mark, draw

    marks = [
        Mark(record, finding.check, *span)
        for finding in inspection.findings
        for record, *span in finding.locations
    ]
    marked_names = {mark.record for mark in marks}
    marked = [r for r in inspection.usable if r.segments or r.name in marked_names]
    draw(
        [(record.record, record.segments) for record in (marked or inspection.usable)[:MAX_DRAWN]],
        path,
        marks=marks,
        force=force,
    )
