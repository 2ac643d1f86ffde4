"""Simulation of a log: a CSV file with the columns of the log and the predicted displacement."""

from pathlib import Path

import numpy as np

from hitchid._support import checks
from hitchid._support.storage import check_inputs, write_file
from hitchid.data.log_records import records_of
from hitchid.data.log_table import LogTable
from hitchid.data.signal_map import SignalMap
from hitchid.data.units import UNITS
from hitchid.model import Hitch
from hitchid.readers import ReaderProcess, assemble, read_table, settings_of
from hitchid.readers.formats import record_name
from hitchid.readers.formats.csv import SUFFIXES, read_rows, write_rows


def simulate_log(
    model: Hitch,
    log: Path,
    out: Path,
    *,
    horizon: int | None = None,
    coverage: float | None = None,
    signals: Path | None = None,
    force: bool = False,
) -> tuple[str, ...]:
    """Write a log's columns and the displacement a model predicts for each of its rows.

    All columns of a text log are copied unchanged; of other formats, time and signals are written.
    A log with gaps is predicted section by section; rows outside the usable sections get an empty cell.

    Args:
        model: an identified hitch.
        log: one log of any known format.
        out: CSV file to write.
        horizon: samples to look ahead, None for free run.
        coverage: share of samples within the band around the prediction; None for no band.
        signals: settings file with the signal map, as `campaign.toml`; None for that of the log's folder.
        force: replace an existing file.

    Returns:
        Warnings where a free run leaves the operating range of the identification tests.

    Raises:
        InputError: an argument or the log cannot be used; its subclasses name log, settings or output.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    log, out = checks.path(log, "log"), checks.path(out, "out")
    signals = None if signals is None else checks.path(signals, "signals")
    check_inputs(out, [log, signals])
    settings = settings_of([log], signals)
    signal_map = settings[log.parent].signals
    with ReaderProcess() as process:
        table = read_table(log, settings[log.parent], process)
    campaign = assemble(records_of(record_name(log), table, signal_map), settings, strict=True)
    header, rows = _as_text(log, table, signal_map)
    time_s = table.time_s
    kinds = ("predicted",) if coverage is None else ("predicted", "lower", "upper")
    columns, warnings = np.full((len(kinds), time_s.size), np.nan), []
    for record in campaign.records:
        values = [model.simulate(record) if horizon is None else model.predict(record, horizon=horizon)]
        if coverage is not None:
            values += model.band(record, coverage=coverage, horizon=horizon)
        warnings += [] if horizon is not None else model.extrapolation(record)
        edge = record.step_s / 2
        inside = (time_s > record.time_s[0] - edge) & (time_s < record.time_s[-1] + edge)
        columns[:, inside] = [np.interp(time_s[inside], record.time_s, series) for series in values]
    names = [added_name(signal_map.displacement.column, kind) for kind in kinds]
    cells = [["" if np.isnan(value) else f"{value:.9g}" for value in row] for row in columns.T.tolist()]
    write_file(
        out,
        lambda path: write_rows(
            path, [*header, *names], [[*row, *added] for row, added in zip(rows, cells, strict=True)]
        ),
        force=force,
    )
    return tuple(warnings)


def _as_text(log: Path, table: LogTable, signals: SignalMap) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a log as text cells."""
    if log.name.lower().endswith(SUFFIXES):
        return read_rows(log)
    time = table.time_s / UNITS[signals.time.unit or "s"].factor
    columns = {signals.time.column: time, **table.columns}
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return list(columns), [[repr(value) for value in row] for row in rows]


def added_name(column: str, kind: str) -> str:
    """Return the name of an added column: `displacement_predicted_mm`, else `<name>_predicted`.

    Args:
        column: column of the measured displacement.
        kind: `predicted`, or `lower` or `upper` for the limits of the band.
    """
    stem, separator, unit = column.partition("displacement_")
    return f"displacement_{kind}_{unit}" if separator and not stem else f"{column}_{kind}"
