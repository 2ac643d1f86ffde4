"""The command that makes a model from logs."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli.cache import prepare_jax, resumable
from hitchid.cli.options import AsJson, Force, Logs, Quiet, Signals


def identify(
    logs: Logs,
    out: Annotated[Path, typer.Option("--out", help="Model folder to write.")],
    config: Annotated[
        Path | None, typer.Option("--config", help="Settings in TOML: structures, search, training.")
    ] = None,
    signals: Signals = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of every random draw [0].")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify a model from logs: dead zones, benchmarks, compensators."""
    from hitchid import display
    from hitchid.storage import check_folder

    check_folder(out, mark="model.json", force=force)
    prepare_jax()
    from hitchid.fitting import Comparison
    from hitchid.identification import Settings, read_settings
    from hitchid.identification import identify as run
    from hitchid.readers import read

    settings: Settings = {} if config is None else read_settings(config)
    if seed is not None:
        settings["seed"] = seed
    settings["comparison"] = resumable(settings.get("comparison", Comparison()))
    campaign = read(logs, signals=signals)
    with display.progress(quiet=quiet) as report:
        found = run(campaign, **settings, progress=report)
    found.save(out, force=force)
    if as_json:
        typer.echo(json.dumps(found.describe(), indent=1))
    elif not quiet:
        display.show_identification(found, out)
