"""`hitchid reproduce`: reproduction of the published study on the virtual test bench."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli.program import AsJson, Force, Quiet, Rig, Seed, check_output, command_line, rig_files


def reproduce(
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    quick: Annotated[bool, typer.Option("--quick", help="Quick study: fewer tests, short training.")] = False,
    rig: Rig = "nominal",
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Repeat the published study on the virtual bench: every table and figure, next to the paper's values."""
    from hitchid.cli import terminal as display

    check_output(out, rig_files(rig), kind="study.md", force=force)
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
