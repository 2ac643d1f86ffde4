"""The command that makes a model from logs."""

import json
import shutil
from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli.cache import prepare_jax, resumable
from hitchid.cli.options import AsJson, Force, Logs, Quiet, Signals
from hitchid.errors import FitError, HitchError, OutputError


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
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a run that was stopped; ends in the same model.")
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify a model from logs: dead zones, benchmarks, compensators."""
    from hitchid import display
    from hitchid.storage import check_folder, check_inputs

    unfinished = out.absolute().with_name(f"{out.absolute().name}.unfinished")
    force = force or (resume and unfinished.is_dir())
    check_folder(out, mark="model.json", force=force)
    check_inputs(out, [*logs, config, signals])
    if unfinished.exists() and not resume:
        _clear(unfinished, force=force)
    prepare_jax()
    from hitchid.audit import audit
    from hitchid.checkpoints import holds_pieces
    from hitchid.fitting import Comparison
    from hitchid.identification import Settings, read_settings
    from hitchid.identification import identify as run
    from hitchid.readers import read

    settings: Settings = {} if config is None else read_settings(config)
    if seed is not None:
        settings["seed"] = seed
    settings["comparison"] = resumable(settings.get("comparison", Comparison()))
    campaign = read(logs, signals=signals)
    display.show_audit(audit(campaign), quiet=quiet)
    try:
        with display.progress(quiet=quiet) as report:
            found = run(campaign, **settings, progress=report, checkpoints=unfinished)
    except HitchError as error:
        if isinstance(error, FitError) or not holds_pieces(unfinished):
            _forget(unfinished)
        raise
    found.save(out, force=force)
    _forget(unfinished)
    if as_json:
        typer.echo(json.dumps(found.describe(), indent=1))
    elif not quiet:
        display.show_identification(found, out)


def _forget(unfinished: Path) -> None:
    """Remove a run that will not be gone on with."""
    from hitchid.checkpoints import is_run

    if is_run(unfinished):
        shutil.rmtree(unfinished, ignore_errors=True)


def _clear(unfinished: Path, *, force: bool) -> None:
    """Make way for a new run in place of one that was stopped."""
    from hitchid.checkpoints import is_run

    if not force:
        raise OutputError(
            f"{unfinished}: holds a run that was stopped; required --resume to go on with it, "
            "or --force to begin anew"
        )
    if not is_run(unfinished):
        raise OutputError(f"{unfinished}: holds no unfinished run, so --force does not replace it")
    shutil.rmtree(unfinished)
