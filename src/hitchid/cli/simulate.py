"""`hitchid simulate`: simulation of a log or of commands alone; the prediction is added to its columns."""

from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.errors import InputError

DEFAULT_COVERAGE = 90  # percent of the samples


def simulate(
    model: options.ModelFolder,
    log: Annotated[Path, typer.Argument(help="One log, or commands alone.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="CSV file to write: the log and the prediction.")],
    initial: Annotated[
        float | None,
        typer.Option("--initial", help="Initial displacement, in the model's unit [as measured in the log]."),
    ] = None,
    load: options.Loads = None,
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
        float | None,
        typer.Option("--coverage", min=50, max=95, help="Coverage of the band, percent of the samples [90]."),
    ] = None,
    signals: options.Signals = None,
    force: options.Force = False,
) -> None:
    """Write the predicted displacement beside a log's columns; with --initial commands alone are enough."""
    from hitchid.cli import terminal as display

    options.check_output(out, [model, log, signals], force=force)
    if horizon != "free" and not (horizon.isdecimal() and int(horizon) > 0):
        raise InputError(f"--horizon: expected 'free' or a whole number of samples above 0, got '{horizon}'")
    if coverage is not None and not bands:
        raise InputError(f"--coverage: expected together with --bands, got --coverage {coverage:g} alone")
    prepare_jax()
    from hitchid.cli.simulated_log import InitialValues, simulate_log
    from hitchid.model import load as load_model

    written = simulate_log(
        load_model(model),
        log,
        out,
        initial=InitialValues(initial, options.loads_of(load)),
        horizon=None if horizon == "free" else int(horizon),
        coverage=(DEFAULT_COVERAGE if coverage is None else coverage) / 100 if bands else None,
        signals=signals,
        force=force,
    )
    display.write_messages("notice", written.notices)
    display.write_result(out, f"{written.samples} samples, displacement predicted in {written.unit}")
