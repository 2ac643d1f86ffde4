"""`hitchid identify`: from logs to a model folder."""

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid._support.progress import ProgressUpdate, subtask_progress
from hitchid.cli.program import AsJson, Force, Logs, Quiet, Signals, Strict, with_search_cache
from hitchid.errors import InputError, OutputError


def identify(
    logs: Logs,
    out: Annotated[Path, typer.Option("--out", help="Model folder to write.")],
    config: Annotated[
        Path | None, typer.Option("--config", help="Settings in TOML: structures, search, training.")
    ] = None,
    signals: Signals = None,
    strict: Strict = False,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of every random draw [0].")
    ] = None,
    with_rivals: Annotated[
        bool,
        typer.Option("--rivals", help="Also train the rivals, after the model is saved; see hitchid rivals."),
    ] = False,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue a stopped run; the model is the same as without the stop."),
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identify a model from logs: dead zones, physics model, corrections.

    The physics model is saved as soon as it is found; Ctrl-C keeps it, and --resume goes on.
    """
    from hitchid._support.files import check_folder, check_inputs
    from hitchid.cli import terminal as display

    unfinished = out.absolute().with_name(f"{out.absolute().name}.unfinished")
    force = force or (resume and unfinished.is_dir())
    from hitchid._support.checkpoints import (
        has_failed,
        has_results,
        is_empty,
        is_run,
        mark_failed,
        remove_run,
    )

    # A stopped run has left its physics model in `out`: how to go on is said before that it exists.
    stopped = unfinished.exists() and not (unfinished.is_dir() and is_empty(unfinished))
    if stopped and not (resume or force or has_failed(unfinished)):
        raise OutputError(
            f"{unfinished}: holds a stopped run; use --resume to continue it, or --force to start again"
        )
    check_folder(out, result_kind="model.json", force=force)
    check_inputs(out, [*logs, config, signals])
    if stopped and not resume:
        if not is_run(unfinished):
            raise OutputError(f"{unfinished}: is not an unfinished run, so --force does not replace it")
        remove_run(unfinished)
    prepare_jax()
    from hitchid.identification import Identification, RivalsConfig, Settings, read_settings, train_rivals
    from hitchid.identification import identify as run
    from hitchid.identification.identify import RIVALS_SHARE
    from hitchid.logs import read
    from hitchid.logs.audit import audit

    settings: Settings = {} if config is None else read_settings(config)
    if seed is not None:
        settings["seed"] = seed
    # Rivals follow when the model is saved.
    rivals = RivalsConfig.of(settings.get("rivals", False))
    settings["rivals"] = replace(rivals, trained=False)
    with_rivals = with_rivals or rivals.trained
    campaign = read(logs, signals=signals, strict=strict)
    display.show_left_out(campaign, quiet=quiet)
    display.show_audit(audit(campaign), quiet=quiet)
    failed_before = has_failed(unfinished)
    if failed_before:
        mark_failed(unfinished, failed=False)
    saved = False

    def save_physics(identification: Identification) -> str:
        nonlocal saved
        identification.save(out, force=force or saved)
        saved = True
        errors = identification.free_run_errors()
        return f"physics model saved: {errors}; going on with corrections, Ctrl-C keeps it"

    try:
        with display.progress(quiet=quiet) as report:
            share = 1 / (1 + RIVALS_SHARE) if with_rivals else 1.0
            identification = run(
                campaign,
                **settings,
                progress=subtask_progress(report, 0.0, share),
                checkpoints=unfinished,
                on_physics=save_physics,
            )
            identification.save(out, force=force or saved)
            if with_rivals:
                report(ProgressUpdate("rivals", share, message=f"model saved: {out}; going on with rivals"))
                model = train_rivals(
                    identification.model,
                    campaign,
                    searches=with_search_cache(rivals.searches),
                    progress=subtask_progress(report, share, 1 - share),
                )
                identification = replace(identification, model=model)
                identification.save(out, force=True)
    except Exception as error:
        refused = isinstance(error, InputError) and not isinstance(error, OutputError)
        # Nothing of a refused run is of use, but with --resume the results may be those of another run. After
        # any other failure, such as a full disk, --resume goes on, or a new run takes the folder.
        if not has_results(unfinished) or (refused and not resume):
            _remove_run(unfinished)
        elif failed_before or not refused:
            mark_failed(unfinished, failed=True)
        raise
    _remove_run(unfinished)
    if as_json:
        typer.echo(json.dumps(identification.describe(), indent=1))
    elif not quiet:
        display.show_identification(identification, out)


def _remove_run(unfinished: Path) -> None:
    """Remove a run that will not be resumed; what cannot be removed stays."""
    from hitchid._support.checkpoints import is_run, remove_run

    if is_run(unfinished):
        with suppress(OSError):
            remove_run(unfinished)
