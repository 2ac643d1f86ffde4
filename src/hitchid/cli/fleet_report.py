"""`hitchid fleet report`: the machines of a fleet beside each other, and those that stand out."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hitchid.cli.options import AsJson, AsPdf, AsXlsx, Force, Quiet, report_formats
from hitchid.cli.program import command_line
from hitchid.errors import InputError

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
    force: Force = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
    as_pdf: AsPdf = False,
    as_xlsx: AsXlsx = False,
) -> None:
    """Compare the machines of a fleet: which stand out, which cohorts differ, what changes with time."""
    from hitchid._support.storage import check_folder, check_inputs
    from hitchid.cli import terminal as display

    check_folder(out, result_kind=MARK, force=force)
    check_inputs(out, [Path(path) for path in (store, machines) if path is not None and "://" not in path])
    if not 0 < level < 1:
        raise InputError(f"--level: got {level:g}, expected between 0 and 1")
    from hitchid._support.data_table import TABLES, csv_files
    from hitchid._support.storage import canonical_json
    from hitchid.fleet import Store, compare_fleet, read_metadata, read_rows
    from hitchid.fleet.comparison_tables import comparison_metrics
    from hitchid.fleet.table import parquet
    from hitchid.report import fleet_report, write_report

    formats = report_formats(as_pdf=as_pdf, as_xlsx=as_xlsx, interactive=False)
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
