"""`hitchid compare`: comparison of models."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.cli.program import command_line
from hitchid.errors import InputError


def compare(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="MODEL MODEL [MODEL]... LOGS...",
            help="Two or more model folders, then log files or folders of logs.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder to write: report.html, comparison.json.")],
    as_pdf: options.AsPdf = False,
    as_xlsx: options.AsXlsx = False,
    interactive: options.Interactive = False,
    signals: options.Signals = None,
    strict: options.Strict = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Compare models with each other on tests that none of them has used."""
    from hitchid.cli import terminal as display

    options.check_output(out, [*paths, signals], kind="comparison.json", force=force)
    prepare_jax()
    from hitchid._support.progress import ProgressUpdate
    from hitchid.model import load
    from hitchid.report import write_report
    from hitchid.validation import compare as run

    formats = options.report_formats(as_pdf=as_pdf, as_xlsx=as_xlsx, interactive=interactive)
    folders, logs = _split(paths)
    models = [load(folder) for folder in folders]
    campaign = display.read_campaign(logs, signals=signals, strict=strict, quiet=quiet)
    with display.progress(quiet=quiet) as report:
        comparison = run(models, campaign, [str(folder) for folder in folders], progress=report)
        report(ProgressUpdate("report", 0.98))
        document = comparison.report(command=command_line())
        write_report(out, document, comparison.files(), formats=formats, mark="comparison.json", force=force)
    if as_json:
        typer.echo(json.dumps(comparison.metrics, indent=1))
    elif not quiet:
        display.show_report(document, comparison.notices, out)


def _split(paths: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return the model folders, which come first, and the logs.

    Raises:
        InputError: fewer than two model folders come first, or no logs follow.
    """
    from hitchid.model import is_model_folder

    count = next((number for number, path in enumerate(paths) if not is_model_folder(path)), len(paths))
    if len(paths) < 2:
        raise InputError(f"expected two or more model folders, then logs; got {paths[0]} alone")
    if count < 2:
        raise InputError(
            f"{paths[count]}: is not a model folder (no model.json); expected two or more "
            "model folders before the logs"
        )
    if count == len(paths):
        raise InputError(f"expected logs after the {count} model folders, got none")
    return paths[:count], paths[count:]
