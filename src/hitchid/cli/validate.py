"""`hitchid validate`: comparison of a model with tests."""

from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.cli.program import command_line
from hitchid.errors import InputError


def validate(
    model: options.ModelFolder,
    logs: options.Logs,
    out: options.ReportFolder,
    accept: options.Accept = None,
    junit: Annotated[
        Path | None, typer.Option("--junit", help="JUnit XML file for the results of the limits.")
    ] = None,
    as_pdf: options.AsPdf = False,
    as_xlsx: options.AsXlsx = False,
    interactive: options.Interactive = False,
    signals: options.Signals = None,
    strict: options.Strict = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Validate a model on tests that were not used for identification."""
    from hitchid._support.files import write_bytes
    from hitchid.cli import terminal as display

    inputs = [model, *logs, accept, signals]
    options.check_output(out, inputs, kind="metrics.json", force=force)
    if junit is not None:
        if accept is None:
            raise InputError("--junit needs --accept")
        options.check_output(junit, inputs, force=force)
    prepare_jax()
    from hitchid._support.progress import ProgressUpdate
    from hitchid.model import load, load_trace
    from hitchid.report import read_trace, render, write_report
    from hitchid.validation import read_limits
    from hitchid.validation import validate as run

    formats = options.report_formats(as_pdf=as_pdf, as_xlsx=as_xlsx, interactive=interactive)
    limits = None if accept is None else read_limits(accept)
    hitch, trace = load(model), read_trace(load_trace(model))
    campaign = display.read_campaign(logs, signals=signals, strict=strict, quiet=quiet)
    if limits is not None:
        limits.check_convertible(campaign.records[0].unit)
    with display.progress(quiet=quiet) as report:
        result = run(hitch, campaign, progress=report)
        acceptance = None if limits is None else result.check(limits)
        report(ProgressUpdate("report", 0.98))
        document = result.report(trace=trace, acceptance=acceptance, command=command_line())
        files = result.files() | ({} if acceptance is None else acceptance.files())
        write_report(out, document, files, formats=formats, mark="metrics.json", force=force)
    if junit is not None and acceptance is not None:
        write_bytes(junit, render(document, "junit"), force=force)
    display.end_with_verdict(
        document, result.metrics, result.notices, acceptance, out, quiet=quiet, as_json=as_json
    )
