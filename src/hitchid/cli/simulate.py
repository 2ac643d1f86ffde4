"""`hitchid simulate`: simulation of a log; the prediction is added to its columns."""

from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli.cache import prepare_jax
from hitchid.cli.options import Force, Signals
from hitchid.errors import InputError


def simulate(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    log: Annotated[Path, typer.Argument(help="One log.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="CSV file to write: the log and the prediction.")],
    horizon: Annotated[
        str,
        typer.Option(
            "--horizon", help="'free' for a free run (commands only), or a prediction horizon in samples."
        ),
    ] = "free",
    bands: Annotated[
        bool, typer.Option("--bands", help="Also write the lower and upper limit of the prediction band.")
    ] = False,
    coverage: Annotated[
        float,
        typer.Option("--coverage", min=50, max=95, help="Coverage of the band, percent of the samples."),
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


def _horizon(text: str) -> int | None:
    if text == "free":
        return None
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError(f"--horizon: expected 'free' or a whole number of samples above 0, got '{text}'")
