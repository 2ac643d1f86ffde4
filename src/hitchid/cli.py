"""The command line: parse, call, show."""

import json
import os
import shlex
import sys
from dataclasses import asdict, replace
from enum import Enum
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid.errors import HitchError, InputError

if TYPE_CHECKING:
    from hitchid.fitting import Comparison
    from hitchid.inspection import Inspection

PICTURES = (".png", ".svg", ".pdf")

app = typer.Typer(
    name="hitchid",
    help="Grey-box models of lifting and lowering hydraulics, identified from bench logs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class Protocol(Enum):
    """What the virtual bench runs."""

    PRBS = "prbs"
    RAMP = "ramp"
    CYCLE = "cycle"


class Direction(Enum):
    """Which direction the virtual bench excites."""

    LIFTING = "lifting"
    LOWERING = "lowering"
    BOTH = "both"


class OneDirection(Enum):
    """Which direction a test excites."""

    LIFTING = "lifting"
    LOWERING = "lowering"


class LogFormat(Enum):
    """Formats the virtual bench writes."""

    CSV = "csv"
    GZIP = "csv.gz"


Logs = Annotated[list[Path], typer.Argument(help="Log files or folders of logs.", show_default=False)]
Signals = Annotated[
    Path | None,
    typer.Option("--signals", help="Signal map in the form of campaign.toml; each folder's own by default."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of tables.")]
AsPdf = Annotated[bool, typer.Option("--pdf", help="Write report.pdf too; needs hitchid[pdf].")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing but what fails.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an older result.")]


@app.command(epilog="Example: hitchid inspect logs/ --draw logs.png")
def inspect(
    logs: Logs,
    signals: Signals = None,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model folder that knows dead zones and dead times.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--draw", help="Picture of the mixed logs to write: .png, .svg or .pdf.")
    ] = None,
    force: Force = False,
    as_json: AsJson = False,
) -> None:
    """Show what logs hold: signals, units, sampling, kinds of test, what mixed logs do, faults."""
    from hitchid import display
    from hitchid.inspection import inspect as look

    if picture is not None:
        _check_picture(picture, force=force)
    switches = None
    if model is not None:
        from hitchid.model import load

        switches = load(model).switches
    found = look(logs, signals=signals, switches=switches)
    if picture is not None:
        _draw(found, picture, force=force)
    if as_json:
        typer.echo(json.dumps(found.describe(), indent=1))
    else:
        display.show_inspection(found)
    if found.faults:
        raise typer.Exit(2)


@app.command(epilog="Example: hitchid identify logs/ --out model")
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
    _prepare_jax()
    from hitchid.fitting import Comparison
    from hitchid.identification import Settings, read_settings
    from hitchid.identification import identify as run
    from hitchid.readers import read

    settings: Settings = {} if config is None else read_settings(config)
    if seed is not None:
        settings["seed"] = seed
    settings["comparison"] = _resumable(settings.get("comparison", Comparison()))
    campaign = read(logs, signals=signals)
    with display.progress(quiet=quiet) as report:
        found = run(campaign, **settings, progress=report)
    found.save(out, force=force)
    if as_json:
        typer.echo(json.dumps(found.describe(), indent=1))
    elif not quiet:
        display.show_identification(found, out)


@app.command(epilog="Example: hitchid validate model logs/ --out results")
def validate(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    logs: Logs,
    out: Annotated[Path, typer.Option("--out", help="Folder to write: report.html, figures, metrics.json.")],
    accept: Annotated[
        Path | None, typer.Option("--accept", help="Limits in TOML; exit code 1 where one does not hold.")
    ] = None,
    junit: Annotated[
        Path | None, typer.Option("--junit", help="JUnit XML file to write the limits' verdicts to.")
    ] = None,
    as_pdf: AsPdf = False,
    signals: Signals = None,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Compare a model with tests its identification has not used."""
    from hitchid import display
    from hitchid.storage import check_file, check_folder, write_bytes

    check_folder(out, mark="metrics.json", force=force)
    if junit is not None:
        if accept is None:
            raise InputError("--junit: required --accept with limits, came none")
        check_file(junit, force=force)
    _prepare_jax()
    from hitchid.model import load, load_trace
    from hitchid.progress import Step
    from hitchid.readers import read
    from hitchid.report import check_pdf, validation_report, write_report
    from hitchid.validation import check_limits, junit_xml, read_limits
    from hitchid.validation import validate as run

    check_pdf(asked=as_pdf)
    limits = None if accept is None else read_limits(accept)
    hitch, trace = load(model), load_trace(model)
    campaign = read(logs, signals=signals)
    if limits is not None:
        limits.check_convertible(campaign.records[0].unit)
    with display.progress(quiet=quiet) as report:
        result = run(hitch, campaign, progress=report)
        acceptance = None if limits is None else check_limits(result.metrics, limits)
        report(Step("report", 0.98))
        document = validation_report(
            result, hitch, campaign, trace=trace, acceptance=acceptance, command=_command()
        )
        write_report(out, document, result.files(), as_pdf=as_pdf, mark="metrics.json", force=force)
    if junit is not None and acceptance is not None:
        write_bytes(junit, junit_xml(acceptance.checks), force=force)
    if as_json:
        accepted = {} if acceptance is None else {"acceptance": acceptance.describe()}
        typer.echo(json.dumps({**result.metrics, **accepted}, indent=1))
    else:
        if not quiet:
            display.show_validation(result, document, out)
        if acceptance is not None:
            display.show_acceptance(acceptance, quiet=quiet)
    if acceptance is not None and not acceptance.passed:
        raise typer.Exit(1)


@app.command(epilog="Example: hitchid compare model-a model-b logs/ --out comparison")
def compare(
    first: Annotated[Path, typer.Argument(metavar="MODEL_A", help="Model folder.", show_default=False)],
    second: Annotated[Path, typer.Argument(metavar="MODEL_B", help="Model folder.", show_default=False)],
    logs: Logs,
    out: Annotated[Path, typer.Option("--out", help="Folder to write: report.html, comparison.json.")],
    as_pdf: AsPdf = False,
    signals: Signals = None,
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Compare two models with each other on tests that neither has used."""
    from hitchid import display
    from hitchid.storage import check_folder

    check_folder(out, mark="comparison.json", force=force)
    _prepare_jax()
    from hitchid.model import load
    from hitchid.progress import Step
    from hitchid.readers import read
    from hitchid.report import check_pdf, comparison_report, write_report
    from hitchid.validation import compare as run

    check_pdf(asked=as_pdf)
    campaign = read(logs, signals=signals)
    with display.progress(quiet=quiet) as report:
        compared = run(load(first), load(second), campaign, progress=report)
        report(Step("report", 0.98))
        document = comparison_report(compared, campaign, names=(str(first), str(second)), command=_command())
        write_report(out, document, compared.files(), as_pdf=as_pdf, mark="comparison.json", force=force)
    if as_json:
        typer.echo(json.dumps(compared.metrics, indent=1))
    elif not quiet:
        display.show_comparison(compared, document, out)


@app.command(epilog="Example: hitchid simulate model test.csv --out simulated.csv --bands")
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
    from hitchid import display
    from hitchid.storage import check_file

    check_file(out, force=force)
    steps = _horizon(horizon)
    _prepare_jax()
    from hitchid.model import load
    from hitchid.simulation import simulate_log

    outside = simulate_log(
        load(model),
        log,
        out,
        horizon=steps,
        coverage=coverage / 100 if bands else None,
        signals=signals,
        force=force,
    )
    display.say("notice", outside)


@app.command(epilog="Example: hitchid design model --direction lifting --out next-test.csv")
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
    from hitchid import display
    from hitchid.storage import check_file

    if out is not None:
        check_file(out, force=force)
    _prepare_jax()
    from hitchid.design import Limits, write_command
    from hitchid.design import design as run
    from hitchid.model import load

    hitch = load(model)
    mode = None if direction is None else direction.value
    advice = run(hitch, mode, parameter=parameter, limits=Limits(highest, travel, longest), seed=seed)
    if out is not None:
        write_command(hitch, advice, out, force=force)
    if as_json:
        typer.echo(json.dumps(asdict(advice), indent=1))
    else:
        display.show_advice(advice, hitch)


@app.command(epilog="Example: recorder | hitchid run model | controller")
def run(
    model: Annotated[Path, typer.Argument(help="Model folder.", show_default=False)],
    initial: Annotated[
        float | None,
        typer.Option("--initial", help="Displacement to start from, in the model's unit [first measured]."),
    ] = None,
    load: Annotated[float, typer.Option("--load", help="Second input before motion, if one is heard.")] = 0.0,
) -> None:
    """Answer samples from standard input, line by line, with the displacement one sample later (JSON)."""
    _prepare_jax()
    from hitchid.live import Live
    from hitchid.model import load as load_model

    live = Live(load_model(model), initial=initial, load=load)
    if isinstance(sys.stdin, TextIOWrapper):
        sys.stdin.reconfigure(encoding="utf-8", errors="replace")
    for line in sys.stdin:
        if line.strip():
            sys.stdout.write(live.hear(line).line() + "\n")
            sys.stdout.flush()


@app.command(epilog="Example: hitchid bench logs --protocol prbs --tests 20")
def bench(
    out: Annotated[Path, typer.Argument(help="Folder to write.", show_default=False)],
    tests: Annotated[
        int | None,
        typer.Option("--tests", min=1, help="Tests a direction, or cycles [20]; ramps a direction [3]."),
    ] = None,
    protocol: Annotated[Protocol, typer.Option("--protocol", help="What is run.")] = Protocol.PRBS,
    mode: Annotated[Direction, typer.Option("--mode", help="Which direction is excited.")] = Direction.BOTH,
    rig: Annotated[str, typer.Option("--rig", help="Parameter set: a name or a TOML file.")] = "nominal",
    log_format: Annotated[LogFormat, typer.Option("--format", help="Format of the logs.")] = LogFormat.CSV,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of every random draw.")] = 0,
    force: Force = False,
) -> None:
    """Run tests on the virtual test bench; write one log a test and campaign.toml."""
    from hitchid.storage import check_folder

    check_folder(out, mark="campaign.toml", force=force)
    _prepare_jax()
    from hitchid.bench import REPEATS, TESTS, write_campaign
    from hitchid.record import MODES

    usual = REPEATS if protocol is Protocol.RAMP else TESTS["prbs"]

    write_campaign(
        out,
        rig,
        tests={protocol.value: usual if tests is None else tests},
        modes=MODES if mode is Direction.BOTH else (mode.value,),
        suffix=log_format.value,
        seed=seed,
        force=force,
    )


@app.command(epilog="Example: hitchid reproduce --out study --quick")
def reproduce(
    out: Annotated[Path, typer.Option("--out", help="Folder to write.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="A first look: fewer tests, short training.")
    ] = False,
    rig: Annotated[str, typer.Option("--rig", help="Parameter set: a name or a TOML file.")] = "nominal",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of every random draw.")] = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Redo the published study on the virtual bench: every table and figure, ours beside theirs."""
    from hitchid import display
    from hitchid.storage import check_folder

    check_folder(out, mark="study.md", force=force)
    _prepare_jax()
    from hitchid.study import Plan, quick_plan
    from hitchid.study import reproduce as run

    plan = quick_plan() if quick else Plan()
    with display.progress(quiet=quiet) as report:
        study = run(out, rig=rig, plan=plan, seed=seed, force=force, progress=report, command=_command())
    if not quiet:
        display.show_study(study, out)


def _check_picture(path: Path, *, force: bool) -> None:
    from hitchid.storage import check_file

    if path.suffix not in PICTURES:
        raise InputError(f"--draw: required a name ending in {', '.join(PICTURES)}, came '{path.name}'")
    check_file(path, force=force)


def _draw(found: "Inspection", path: Path, *, force: bool) -> None:
    if not found.mixed:
        raise InputError("--draw: none of the logs moves both ways; there is nothing to draw")
    from hitchid.report.figures.timeline import draw

    draw(found.mixed, path, force=force)


def _command() -> str:
    """Return the command as it was given, for who wants to give it again."""
    return shlex.join(["hitchid", *sys.argv[1:]])


def _horizon(text: str) -> int | None:
    if text == "free":
        return None
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError(f"--horizon: required 'free' or a whole number of samples above 0, came '{text}'")


def _prepare_jax() -> None:
    """Keep compiled programs in the user's cache, so that the second run starts faster."""
    import jax

    jax.config.update("jax_compilation_cache_dir", str(_cache() / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def _resumable(comparison: "Comparison | None") -> "Comparison | None":
    """Keep finished searches in the user's cache, so that a run that was stopped goes on from there."""
    return comparison and replace(comparison, folder=_cache() / "searches")


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hitchid"


def main() -> None:
    """Run the command line; exit 0 for success, 2 for wrong use or bad input, 1 for a run that failed."""
    try:
        app()
    except InputError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(2)
    except HitchError as error:
        sys.stderr.write(f"hitchid: {error}\n")
        sys.exit(1)
