"""`hitchid run`: online prediction, sample by sample from standard input."""

import sys
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.compilation_cache import prepare_jax
from hitchid.cli.options import Loads, loads_of


def run(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    initial: Annotated[
        float | None,
        typer.Option("--initial", help="Initial displacement, in the model's unit [first measured]."),
    ] = None,
    load: Loads = None,
) -> None:
    """Read samples from standard input, line by line; write the displacement one sample later (JSON)."""
    prepare_jax()
    from hitchid.model import load as load_model
    from hitchid.online.live import Live

    live = Live(load_model(model), initial=initial, load=loads_of(load))
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(encoding="utf-8", errors="replace")
    sys.stderr.write("ready\n")
    sys.stderr.flush()
    for line in sys.stdin:
        sys.stdout.write(live.process(line).to_json() + "\n")
        sys.stdout.flush()
