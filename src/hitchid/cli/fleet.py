"""`hitchid fleet`: many machines identified, compared and watched."""

import json
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid.cli import options
from hitchid.cli.program import command_line
from hitchid.errors import HitchError, InputError

if TYPE_CHECKING:
    from hitchid._support.progress import ProgressCallback
    from hitchid.fleet import FleetProgress, FleetResult, Runner


# `hitchid fleet report`: the machines of a fleet beside each other, and those that stand out.

MARK = "comparison.json"  # the file that identifies an older result


def report(
    store: Annotated[
        str,
        typer.Argument(
            help="Folder or URL of the results that hitchid fleet identify wrote.", show_default=False
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", help="Folder to write: report.html, comparison.json, tables.")
    ],
    machines: Annotated[
        str | None,
        typer.Option("--machines", help="CSV file with a column machine and others, such as type or age_h."),
    ] = None,
    level: Annotated[
        float,
        typer.Option("--level", help="False discovery rate: share of sound ones among the machines named."),
    ] = 0.1,
    force: options.Force = False,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
    as_pdf: options.AsPdf = False,
    as_xlsx: options.AsXlsx = False,
) -> None:
    """Compare the machines of a fleet: which stand out, which cohorts differ, what changes with time."""
    from hitchid.cli import terminal as display

    local = [Path(path) for path in (store, machines) if path is not None and "://" not in path]
    options.check_output(out, local, kind=MARK, force=force)
    if not 0 < level < 1:
        raise InputError(f"--level: got {level:g}, expected between 0 and 1")
    from hitchid._support.files import canonical_json
    from hitchid._support.tables import TABLES, csv_files
    from hitchid.fleet import Store, compare_fleet, read_metadata, read_rows
    from hitchid.fleet.comparison import comparison_metrics
    from hitchid.fleet.ledger import parquet
    from hitchid.fleet.report import fleet_report
    from hitchid.report import write_report

    formats = options.report_formats(as_pdf=as_pdf, as_xlsx=as_xlsx, interactive=False)
    rows = read_rows(Store(store))
    if not rows:
        raise InputError(f"{store}: has no results of a fleet; expected what hitchid fleet identify wrote")
    metadata = None if machines is None else read_metadata(machines)
    comparison = compare_fleet(rows, metadata, false_discovery_rate=level)
    document = fleet_report(comparison, source=store, command=command_line())
    metrics = comparison_metrics(comparison)
    tables = comparison.tables.values()
    files = {
        MARK: canonical_json(metrics),
        **csv_files(tables),
        **{f"{TABLES}/{table.name}.parquet": parquet(table) for table in tables},
    }
    write_report(out, document, files, mark=MARK, formats=formats, force=force)
    if as_json:
        typer.echo(json.dumps(metrics, indent=1))
    elif not quiet:
        display.show_report(document, comparison.notices, out)


app = typer.Typer(
    name="fleet",
    help="Many machines: identify a model of each, compare them, and watch new logs.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


class RunnerName(Enum):
    """Runners."""

    LOCAL = "local"
    DASK = "dask"


Store = Annotated[
    str,
    typer.Argument(help="Folder or URL (s3://…) with a folder of logs for each machine.", show_default=False),
]
Out = Annotated[
    str, typer.Option("--out", help="Folder or URL of the results: models, a row a machine, fleet.csv.")
]
RunnerOption = Annotated[RunnerName, typer.Option("--runner", help="Processes here, or dask.distributed.")]
Workers = Annotated[int | None, typer.Option("--workers", min=1, help="Number of processes [one a core].")]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", help="A running dask scheduler: tls://HOST:PORT [starts one here]."),
]


def identify(
    store: Store,
    out: Out,
    config: Annotated[
        Path | None, typer.Option("--config", help="Settings in TOML, the same for all machines.")
    ] = None,
    runner: RunnerOption = RunnerName.LOCAL,
    workers: Workers = None,
    scheduler: Scheduler = None,
    seed: options.OptionalSeed = None,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Identify a model of each machine that has none yet; another run goes on where this one stopped."""
    from hitchid.cli import terminal as display
    from hitchid.fleet import identify_fleet

    settings = options.settings_of(config, seed)
    settings["rivals"] = None
    with display.progress(quiet=quiet) as shown:
        result = identify_fleet(
            store,
            out,
            settings=settings,
            runner=_runner(runner, workers, scheduler, quiet=quiet),
            progress=lambda update: _report(update, shown),
        )
    _show(result, out, quiet=quiet, as_json=as_json)


def _runner(name: RunnerName, workers: int | None, scheduler: str | None, *, quiet: bool) -> "Runner":
    """Return the runner of the options; dask's page is named on stderr."""
    from hitchid.fleet import Runner

    def show_page(page: str) -> None:
        if not quiet:
            typer.echo(f"dask shows its work at {page}", err=True)

    return Runner(name.value, workers, scheduler, show_page)


def _report(update: "FleetProgress", shown: "ProgressCallback") -> None:
    """Show one machine that has ended, and how many are left."""
    from hitchid._support.progress import ProgressUpdate

    if update.last is None:
        stage = f"{update.found} machines are done, {update.total} to identify"
    else:
        message = f": {update.last.message}" if update.last.message else ""
        stage = f"{update.last.machine}: {update.last.state} in {update.last.seconds:.3g} s{message}"
        if update.left_s is not None:
            stage = f"{stage} ({update.total - update.finished} left, about {update.left_s:.0f} s)"
    shown(ProgressUpdate(stage, update.finished / update.total if update.total else 1.0))


def _show(result: "FleetResult", out: str, *, quiet: bool, as_json: bool) -> None:
    """Print the result; a machine without a row ends the command with exit code 1."""
    from hitchid.cli import terminal as display
    from hitchid.fleet.parameters import listed

    if as_json:
        rows = [asdict(row) for row in result.rows]
        content = {"worked": result.worked, "unfinished": dict(result.unfinished), "rows": rows}
        typer.echo(json.dumps(content, indent=1))
    elif not quiet:
        counts = ", ".join(f"{count} {state}" for state, count in result.counts.items())
        typer.echo(
            f"{len(result.rows)} machines: {counts or 'none'}; {result.worked} worked on now; in {out}"
        )
    failures = [f"{listed(machines)}: {cause}" for cause, machines in result.failures.items()]
    display.write_messages("warning", () if quiet else failures)
    if result.unfinished:
        machine, reason = next(iter(result.unfinished.items()))
        raise HitchError(
            f"{len(result.unfinished)} machines are unfinished, such as {machine}: {reason}; "
            "run the command again"
        )


def validate(
    store: Annotated[
        str,
        typer.Argument(help="Folder or URL with a folder of new logs for each machine.", show_default=False),
    ],
    models: Annotated[str, typer.Option("--models", help="Results of hitchid fleet identify.")],
    out: Annotated[
        str, typer.Option("--out", help="Folder or URL of the results: a row a machine, fleet.csv.")
    ],
    runner: RunnerOption = RunnerName.LOCAL,
    workers: Workers = None,
    scheduler: Scheduler = None,
    quiet: options.Quiet = False,
    as_json: options.AsJson = False,
) -> None:
    """Run new logs of each machine against its model; shows faults first, then the largest drift."""
    from hitchid.cli import terminal as display
    from hitchid.fleet import ranked, validate_fleet

    with display.progress(quiet=quiet) as shown:
        result = validate_fleet(
            store,
            models,
            out,
            runner=_runner(runner, workers, scheduler, quiet=quiet),
            progress=lambda update: _report(update, shown),
        )
    if not (quiet or as_json):
        display.show_drift(ranked(result.rows))
    _show(result, out, quiet=quiet, as_json=as_json)


for _command, _example in (
    (identify, "hitchid fleet identify logs/ --out results/"),
    (report, "hitchid fleet report results/ --out report/"),
    (validate, "hitchid fleet validate new-logs/ --models results/ --out watch/"),
):
    app.command(epilog=f"Example: {_example}")(_command)
