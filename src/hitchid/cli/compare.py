"""`hitchid compare`: comparison of two models."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli.cache import prepare_jax
from hitchid.cli.options import (
    AsJson,
    AsPdf,
    AsXlsx,
    Force,
    Interactive,
    Logs,
    Quiet,
    Signals,
    Strict,
    report_formats,
)
from hitchid.cli.program import command_line


def compare(
    first: Annotated[Path, typer.Argument(metavar="MODEL_A", help="Model folder.", show_default=False)],
    second: Annotated[Path, typer.Argument(metavar="MODEL_B", help="Model folder.", show_default=False)],
    logs: Logs,
    out: Annotated[Path, typer.Option("--out", help="Folder to write: report.html, comparison.json.")],
    as_pdf: AsPdf = False,
    as_xlsx: AsXlsx = False,
    interactive: Interactive = False,
    signals: Signals = None,
    strict: Strict = False,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Compare two models with each other on tests that neither has used."""
    from hitchid._support.storage import check_folder, check_inputs
    from hitchid.cli import terminal as display

    check_folder(out, result_kind="comparison.json", force=force)
    check_inputs(out, [first, second, *logs, signals])
    prepare_jax()
    from hitchid._support.progress import ProgressUpdate
    from hitchid.model import load
    from hitchid.readers import read
    from hitchid.report import write_report
    from hitchid.validation import compare as run

    formats = report_formats(as_pdf=as_pdf, as_xlsx=as_xlsx, interactive=interactive)
    campaign = read(logs, signals=signals, strict=strict)
    display.show_left_out(campaign, quiet=quiet)
    with display.progress(quiet=quiet) as report:
        comparison = run(load(first), load(second), campaign, progress=report)
        report(ProgressUpdate("report", 0.98))
        document = comparison.report(names=(str(first), str(second)), command=command_line())
        write_report(out, document, comparison.files(), formats=formats, mark="comparison.json", force=force)
    if as_json:
        typer.echo(json.dumps(comparison.metrics, indent=1))
    elif not quiet:
        display.show_report(document, comparison.notices, out)
