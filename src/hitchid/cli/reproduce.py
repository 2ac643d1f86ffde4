"""`hitchid reproduce`: reproduction of the published study on the virtual test bench."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.cli.program import command_line


def reproduce(
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    quick: Annotated[bool, typer.Option("--quick", help="Quick study: fewer tests, short training.")] = False,
    rig: options.Rig = "nominal",
    seed: options.Seed = 0,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Repeat the published study on the virtual bench: every table and figure, next to the paper's values."""
    from hitchid.cli import terminal as display

    options.check_output(out, options.rig_files(rig), kind="study.md", force=force)
    prepare_jax()
    from hitchid.bench.sun2025 import Plan, quick_plan
    from hitchid.bench.sun2025.reproduce import reproduce as run

    plan = quick_plan() if quick else Plan()
    with display.progress(quiet=quiet) as report:
        study = run(out, rig=rig, plan=plan, seed=seed, force=force, progress=report, command=command_line())
    if as_json:
        typer.echo(json.dumps(study.validation.metrics, indent=1))
    elif not quiet:
        display.show_study(study, out)
