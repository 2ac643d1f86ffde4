"""`hitchid design`: experiment design for the next test."""

import json
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options


class OneDirection(Enum):
    """Direction that a test excites."""

    LIFTING = "lifting"
    LOWERING = "lowering"


class Purpose(Enum):
    """What the test is for."""

    CONTROL = "control"


Direction = Annotated[
    OneDirection | None,
    typer.Option("--direction", help="Direction to test [the one with the least determined parameter]."),
]
Reduced = Annotated[
    str | None,
    typer.Option(
        "--parameter", help="Parameter whose error to reduce, such as time_constant [least determined]."
    ),
]
For = Annotated[
    Purpose | None,
    typer.Option("--for", help="Test for a controller: of the parameter that its margins depend on most."),
]
Highest = Annotated[
    float | None,
    typer.Option("--highest", help="Largest command allowed, in the model's unit [largest in the tests]."),
]
Travel = Annotated[
    float | None,
    typer.Option("--travel", min=0, help="Largest travel allowed, in the model's unit [from the tests]."),
]
Longest = Annotated[
    float | None,
    typer.Option("--longest", min=0, help="Longest duration allowed, s [twice that of the tests]."),
]
Out = Annotated[Path | None, typer.Option("--out", help="CSV file for the command of the best test.")]


def design(
    model: options.ModelFolder,
    direction: Direction = None,
    parameter: Reduced = None,
    purpose: For = None,
    highest: Highest = None,
    travel: Travel = None,
    longest: Longest = None,
    out: Out = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the candidate tests.")] = 0,
    force: options.Force = False,
    as_json: options.AsJson = False,
) -> None:
    """Propose the next test: the one that most reduces the error of the least determined parameter.

    For a controller, it is that of the parameter on which its stability margins depend most.
    """
    from hitchid.cli import terminal as display

    if out is not None:
        options.check_output(out, [model], force=force)
    prepare_jax()
    from hitchid.control import limitation
    from hitchid.control.next_test import ExcitationLimits, write_command
    from hitchid.control.next_test import design as run
    from hitchid.errors import SettingsError
    from hitchid.model import load

    hitch = load(model)
    direction_name = None if direction is None else direction.value
    limits_control = None
    if purpose is Purpose.CONTROL:
        if parameter is not None:
            raise SettingsError("--for control: chooses the parameter itself; leave out --parameter")
        limits_control = limitation(hitch, direction_name, seed=seed)
        direction_name, parameter = limits_control.direction, limits_control.parameter
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
        control = {} if limits_control is None else {"control": asdict(limits_control)}
        typer.echo(json.dumps({**advice.describe(), **control}, indent=1))
    else:
        if limits_control is not None:
            display.show_limitation(limits_control)
        display.show_advice(advice, hitch)
