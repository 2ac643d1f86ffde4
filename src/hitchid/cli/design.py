"""`hitchid design`: experiment design for the next test."""

import json
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.compilation_cache import prepare_jax
from hitchid.cli.options import AsJson, Force


class OneDirection(Enum):
    """Direction that a test excites."""

    LIFTING = "lifting"
    LOWERING = "lowering"


def design(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    direction: Annotated[
        OneDirection | None,
        typer.Option("--direction", help="Direction to test [the one with the least determined parameter]."),
    ] = None,
    parameter: Annotated[
        str | None,
        typer.Option(
            "--parameter", help="Parameter whose error to reduce, such as time_constant [least determined]."
        ),
    ] = None,
    highest: Annotated[
        float | None,
        typer.Option(
            "--highest", help="Largest command allowed, in the model's unit [largest in the tests]."
        ),
    ] = None,
    travel: Annotated[
        float | None,
        typer.Option("--travel", min=0, help="Largest travel allowed, in the model's unit [from the tests]."),
    ] = None,
    longest: Annotated[
        float | None,
        typer.Option("--longest", min=0, help="Longest duration allowed, s [twice that of the tests]."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="CSV file for the command of the best test.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the candidate tests.")] = 0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Propose the next test: the one that most reduces the error of the least determined parameter."""
    from hitchid._support.storage import check_file, check_inputs
    from hitchid.cli import terminal as display

    if out is not None:
        check_file(out, force=force)
        check_inputs(out, [model])
    prepare_jax()
    from hitchid.design.next_test import ExcitationLimits, write_command
    from hitchid.design.next_test import design as run
    from hitchid.model import load

    hitch = load(model)
    direction_name = None if direction is None else direction.value
    advice = run(
        hitch,
        direction_name,
        parameter=parameter,
        limits=ExcitationLimits(highest, travel, longest),
        seed=seed,
    )
    if out is not None:
        write_command(hitch, advice, out, force=force)
    if as_json:
        typer.echo(json.dumps(advice.describe(), indent=1))
    else:
        display.show_advice(advice, hitch)
