"""`hitchid identify`: from logs to a model folder."""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid._support.jax_setup import prepare_jax
from hitchid._support.progress import ProgressCallback, ProgressUpdate, subtask_progress
from hitchid.cli import options
from hitchid.cli.program import with_search_cache
from hitchid.errors import InputError, OutputError

if TYPE_CHECKING:
    from hitchid.identification import Identification, RivalsConfig
    from hitchid.logs.campaign import Campaign

GOING_ON = "going on with corrections, Ctrl-C keeps it"
Out = Annotated[Path, typer.Option("--out", help="Model folder to write.")]
Config = Annotated[
    Path | None, typer.Option("--config", help="Settings in TOML: structures, search, training.")
]
WithRivals = Annotated[
    bool,
    typer.Option("--rivals", help="Also train the rivals, after the model is saved; see hitchid rivals."),
]
Resume = Annotated[
    bool,
    typer.Option("--resume", help="Continue a stopped run; the model is the same as without the stop."),
]


def identify(
    logs: options.Logs,
    out: Out,
    config: Config = None,
    signals: options.Signals = None,
    strict: options.Strict = False,
    seed: options.OptionalSeed = None,
    with_rivals: WithRivals = False,
    resume: Resume = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Identify a model from logs: dead zones, physics model, corrections.

    The physics model is saved as soon as it is found; Ctrl-C keeps it, and --resume goes on.
    """
    unfinished = out.absolute().with_name(f"{out.absolute().name}.unfinished")
    force = force or (resume and unfinished.is_dir())  # the stopped run has left its model in `out`
    _check_places(out, unfinished, [*logs, config, signals], resume=resume, force=force)
    prepare_jax()
    from hitchid.cli import terminal as display
    from hitchid.identification import RivalsConfig
    from hitchid.identification import identify as run
    from hitchid.identification.identify import RIVALS_SHARE
    from hitchid.logs.audit import audit

    settings = options.settings_of(config, seed)
    rivals = RivalsConfig.of(settings.get("rivals", False))
    settings["rivals"] = replace(rivals, trained=False)  # they follow when the model is saved
    with_rivals = with_rivals or rivals.trained
    campaign = display.read_campaign(logs, signals=signals, strict=strict, quiet=quiet)
    display.show_audit(audit(campaign), quiet=quiet)
    saved = False

    def save_physics(identification: "Identification") -> str:
        nonlocal saved
        identification.save(out, force=force or saved)
        saved = True
        return f"physics model saved: {identification.free_run_errors()}; {GOING_ON}"

    with _kept_where_useful(unfinished, resume=resume), display.progress(quiet=quiet) as report:
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
            progress = subtask_progress(report, share, 1 - share)
            identification = _with_rivals(identification, campaign, rivals, progress)
            identification.save(out, force=True)
    if as_json:
        typer.echo(json.dumps(identification.describe(), indent=1))
    elif not quiet:
        display.show_identification(identification, out)


def _with_rivals(
    identification: "Identification",
    campaign: "Campaign",
    rivals: "RivalsConfig",
    progress: ProgressCallback,
) -> "Identification":
    """Return an identification with its rivals trained; a stopped one finds the searches that it finished."""
    from hitchid.identification import train_rivals

    searches = with_search_cache(rivals.searches)
    model = train_rivals(identification.model, campaign, searches=searches, progress=progress)
    return replace(identification, model=model)


def _check_places(
    out: Path, unfinished: Path, inputs: list[Path | None], *, resume: bool, force: bool
) -> None:
    """Check that a run may write where it is told to, and remove a stopped one that is not gone on with.

    Raises:
        OutputError: a model or a stopped run is in the way.
    """
    from hitchid._support.checkpoints import has_failed, is_empty, is_run, remove_run

    # A stopped run has left its physics model in `out`: how to go on is said before that it exists.
    stopped = unfinished.exists() and not (unfinished.is_dir() and is_empty(unfinished))
    if stopped and not (resume or force or has_failed(unfinished)):
        raise OutputError(
            f"{unfinished}: holds a stopped run; use --resume to continue it, or --force to start again"
        )
    options.check_output(out, inputs, kind="model.json", force=force)
    if stopped and not resume:
        if not is_run(unfinished):
            raise OutputError(f"{unfinished}: is not an unfinished run, so --force does not replace it")
        remove_run(unfinished)


@contextmanager
def _kept_where_useful(unfinished: Path, *, resume: bool) -> Iterator[None]:
    """Keep the results of a run that fails where --resume may go on from them; remove those of any other."""
    from hitchid._support.checkpoints import has_failed, has_results, mark_failed

    failed_before = has_failed(unfinished)
    if failed_before:
        mark_failed(unfinished, failed=False)
    try:
        yield
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


def _remove_run(unfinished: Path) -> None:
    """Remove a run that will not be resumed; what cannot be removed stays."""
    from hitchid._support.checkpoints import is_run, remove_run

    if is_run(unfinished):
        with suppress(OSError):
            remove_run(unfinished)
