"""`hitchid tune`: a position controller from a model, with margins over what its tests leave open."""

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.cli.program import command_line


def tune(
    model: options.ModelFolder,
    out: Annotated[Path, typer.Option("--out", help="Controller file to write, TOML.")],
    report_folder: Annotated[
        Path | None,
        typer.Option("--report", help="Folder to write: report.html with margins, Bode and Nichols plots."),
    ] = None,
    load: options.Loads = None,
    draws: Annotated[
        int, typer.Option("--draws", min=20, max=10000, help="Drawn parameter vectors of the margins.")
    ] = 200,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draws.")] = 0,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Tune a position controller: the fastest that keeps its margins over draws of the parameters."""
    from hitchid.cli import terminal as display

    options.check_output(out, [model], force=force)
    if report_folder is not None:
        options.check_output(report_folder, [model], kind=out.name, force=force)
    prepare_jax()
    from hitchid.control import load_controller, save_controller
    from hitchid.control import tune as run
    from hitchid.control.tune_report import tune_report
    from hitchid.model import load as load_model
    from hitchid.report import write_report

    hitch = load_model(model)
    with display.progress(quiet=quiet) as report:
        tuning = run(hitch, load=options.loads_of(load), draws=draws, seed=seed, progress=report)
    # Relative to the file, so that both can move together.
    folder = Path(os.path.relpath(model.resolve(), out.resolve().parent)).as_posix()
    save_controller(tuning, hitch, out, model_folder=folder, force=force)
    if report_folder is not None:
        document = tune_report(tuning, command=command_line())
        write_report(report_folder, document, {out.name: out.read_bytes()}, mark=out.name, force=force)
    if as_json:
        margins = load_controller(out).margins
        typer.echo(json.dumps({"method": tuning.method, "margins": margins}, indent=1))
    elif not quiet:
        display.show_tuning(tuning, out)
