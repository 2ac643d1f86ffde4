"""Commands that use a model."""

import json
import sys
from dataclasses import asdict
from enum import Enum
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli.cache import prepare_jax
from hitchid.cli.options import AsJson, Force, Signals
from hitchid.errors import InputError


class OneDirection(Enum):
    """Which direction a test excites."""

    LIFTING = "lifting"
    LOWERING = "lowering"


def simulate(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    log: Annotated[Path, typer.Argument(help="One log.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="CSV file to write: the log and the prediction.")],
    horizon: Annotated[
        str,
        typer.Option("--horizon", help="'free' for commands alone, or a number of samples to look ahead."),
    ] = "free",
    bands: Annotated[
        bool, typer.Option("--bands", help="Write the ends of a band around the prediction too.")
    ] = False,
    coverage: Annotated[
        float,
        typer.Option("--coverage", min=50, max=95, help="Percent of the samples the band shall hold."),
    ] = 90,
    signals: Signals = None,
    force: Force = False,
) -> None:
    """Write the predicted displacement beside a log's columns."""
    from hitchid._support.storage import check_file, check_inputs
    from hitchid.cli import terminal as display

    check_file(out, force=force)
    check_inputs(out, [model, log, signals])
    steps = _horizon(horizon)
    prepare_jax()
    from hitchid.model import load
    from hitchid.model.simulate_log import simulate_log

    notices = simulate_log(
        load(model),
        log,
        out,
        horizon=steps,
        coverage=coverage / 100 if bands else None,
        signals=signals,
        force=force,
    )
    display.write_messages("notice", notices)


def design(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    direction: Annotated[
        OneDirection | None,
        typer.Option("--direction", help="Direction to test [the one with the least determined parameter]."),
    ] = None,
    parameter: Annotated[
        str | None,
        typer.Option("--parameter", help="Parameter to narrow, such as time_constant [least determined]."),
    ] = None,
    highest: Annotated[
        float | None,
        typer.Option("--highest", help="Largest command, in the model's unit [that of the tests]."),
    ] = None,
    travel: Annotated[
        float | None,
        typer.Option("--travel", min=0, help="Farthest way, in the model's unit [that of the tests]."),
    ] = None,
    longest: Annotated[
        float | None, typer.Option("--longest", min=0, help="Longest duration, s [twice the tests'].")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="CSV file to write the best test's command to.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the candidates.")] = 0,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Propose the next test: the one that narrows the least determined parameter most."""
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
        typer.echo(json.dumps(asdict(advice), indent=1))
    else:
        display.show_advice(advice, hitch)


def run(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    initial: Annotated[
        float | None,
        typer.Option("--initial", help="Displacement to start from, in the model's unit [first measured]."),
    ] = None,
    load: Annotated[float, typer.Option("--load", help="Second input before motion, if one is heard.")] = 0.0,
) -> None:
    """Answer samples from standard input, line by line, with the displacement one sample later (JSON)."""
    prepare_jax()
    from hitchid.model import load as load_model
    from hitchid.online.live import Live

    live = Live(load_model(model), initial=initial, load=load)
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(encoding="utf-8", errors="replace")
    sys.stderr.write("ready\n")
    sys.stderr.flush()
    for line in sys.stdin:
        sys.stdout.write(live.process(line).to_json() + "\n")
        sys.stdout.flush()


def _horizon(text: str) -> int | None:
    if text == "free":
        return None
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError(f"--horizon: required 'free' or a whole number of samples above 0, came '{text}'")
