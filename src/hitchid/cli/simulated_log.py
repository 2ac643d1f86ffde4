"""Simulation of a log: a CSV file with the columns of the log and the predicted displacement."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support import checks
from hitchid._support.files import check_inputs, write_file
from hitchid.errors import InputError, LogError
from hitchid.logs import ReaderProcess, assemble, read_table, settings_of
from hitchid.logs.formats import record_name
from hitchid.logs.formats.text import SUFFIXES, TextRows, read_rows, write_rows
from hitchid.logs.log_table import LogTable, records_of
from hitchid.logs.record import DISPLACEMENT, Record
from hitchid.logs.signal_map import CampaignFile, SignalColumn, SignalMap, command_columns
from hitchid.logs.units import UNITS
from hitchid.model import Hitch
from hitchid.model.inputs import Load, covariates_of, loads_by_name


class InitialValues(NamedTuple):
    """Initial values of a free run that replace those of the log, in the model's units.

    Attributes:
        displacement: initial displacement; None for the one measured in the log.
        load: covariates before motion, by name; those that are not given are those of the log.
    """

    displacement: float | None = None
    load: Load | None = None


class SimulatedLog(NamedTuple):
    """What was written.

    Attributes:
        samples: number of samples with a prediction.
        unit: unit of the prediction.
        notices: sentences on what of the log was not used, and on signals outside the identified range.
    """

    samples: int
    unit: str
    notices: tuple[str, ...]


FROM_LOG = InitialValues()


def simulate_log(
    model: Hitch,
    log: Path,
    out: Path,
    *,
    initial: InitialValues = FROM_LOG,
    horizon: int | None = None,
    coverage: float | None = None,
    signals: Path | None = None,
    force: bool = False,
) -> SimulatedLog:
    """Write a log's columns and the displacement a model predicts for each of its rows.

    All columns of a text log are copied unchanged; of other formats, time and signals are written.
    A log with gaps is predicted section by section; rows outside the usable sections get an empty cell.
    With an initial displacement the log may hold commands alone, such as the file of `hitchid design`.
    A horizon of None is a free run, and a coverage of None no band.

    Raises:
        InputError: an argument or the log cannot be used; its subclasses name log, settings or output.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    log, out = checks.path(log, "log"), checks.path(out, "out")
    signals = None if signals is None else checks.path(signals, "signals")
    check_inputs(out, [log, signals])
    if horizon is not None and initial != FROM_LOG:
        raise InputError(
            f"a prediction {horizon} samples ahead requires the measured displacement; --initial and --load "
            "apply to --horizon free"
        )
    all_settings = settings_of([log], signals)
    text = read_rows(log) if log.name.lower().endswith(SUFFIXES) else None
    names = () if text is None else text.header
    settings = all_settings[log.parent]
    required = _required_signals(settings.signals, model, names, initial)
    settings = settings.model_copy(update={"signals": required})
    table = _read(log, settings, initial, free_run=horizon is None)
    measured = settings.signals.displacement if DISPLACEMENT in table.signals else None
    if initial.displacement is None:
        records = assemble(
            records_of(record_name(log), table, settings.signals), all_settings, strict=True
        ).records
    else:
        records = [_commands(record_name(log), table, model, settings.signals)]
    unit = records[0].unit
    columns, flags = _predictions(model, table.time_s, records, initial, horizon, coverage)
    notices = [*dict.fromkeys(str(notice) for record in records for notice in record.notices), *flags]
    if measured is not None and initial.displacement is not None:
        notices = [
            f"'{measured.column}' is not used: the simulation starts from {initial.displacement:g} "
            f"{model.units[DISPLACEMENT]}",
            *notices,
        ]
    base = f"displacement_{unit}" if measured is None else measured.column
    added = [added_name(base, kind) for kind in ("predicted", "lower", "upper")[: len(columns)]]
    header, rows = _with_cells(text, table, settings.signals.time, columns)
    write_file(out, lambda path: write_rows(path, [*header, *added], rows), force=force)
    return SimulatedLog(int(np.count_nonzero(~np.isnan(columns[0]))), unit, tuple(notices))


def _with_cells(
    text: TextRows | None, table: LogTable, time: SignalColumn, columns: np.ndarray
) -> tuple[Sequence[str], list[list[str]]]:
    """Return the header of a log, and its rows with the cells of predicted columns behind."""
    cells = [["" if np.isnan(value) else f"{value:.9g}" for value in row] for row in columns.T.tolist()]
    if text is None:
        series = {time.column: table.time_s / UNITS[time.unit or "s"].factor, **table.columns}
        samples = zip(*map(np.ndarray.tolist, series.values()), strict=True)
        return list(series), [[*map(repr, row), *own] for row, own in zip(samples, cells, strict=True)]
    # Lines without a sample, such as comments, stay and have no prediction.
    by_line, none = {table.line_of(sample): own for sample, own in enumerate(cells)}, [""] * len(columns)
    lines = zip(text.rows, text.lines, strict=True)
    return text.header, [[*row, *by_line.get(line, none)] for row, line in lines]


def _required_signals(
    signals: SignalMap, model: Hitch, names: Sequence[str], initial: InitialValues
) -> SignalMap:
    """Return the signal map with what a simulation requires.

    The commands are those of a file of `hitchid design` if the log has its columns, not the mapped ones.
    """
    mapped = [signals.command, signals.lifting_command, signals.lowering_command]
    designed = command_columns(model.channels, model.units)
    if any(column is not None and column.column not in names for column in mapped) and all(
        column.column in names for column in designed.values()
    ):
        signals = SignalMap(displacement=signals.displacement, covariates=signals.covariates, **designed)
    if initial == FROM_LOG:
        return signals
    names = covariates_of(model.channels.values())
    given = loads_by_name(initial.load, names, "model")
    required = [name for name in names if name not in given]
    covariates = tuple(column for column in signals.covariates if column.column in required)
    return signals.model_copy(update={"covariates": covariates})


def _read(log: Path, settings: CampaignFile, initial: InitialValues, *, free_run: bool) -> LogTable:
    """Read a log, without its displacement where there is none and an initial one is given."""
    displacement = settings.signals.displacement
    with ReaderProcess() as process:
        table = None
        try:
            table = read_table(log, settings, process)
        except LogError as error:
            if displacement is None or error.column != displacement.column:
                raise
            if initial.displacement is None:
                hint = "; without it, give the initial displacement: --initial" if free_run else ""
                raise LogError(log, f"{error.problem}{hint}", line=error.line, column=error.column) from error
        if table is not None and (displacement is None or initial.displacement is None):
            return table
        without = settings.signals.model_copy(update={"displacement": None})
        commands = read_table(log, settings.model_copy(update={"signals": without}), process)
        # Gaps of a displacement that is not used cut nothing out.
        return commands if table is None or table.time_s.size < commands.time_s.size else table


def _commands(name: str, table: LogTable, model: Hitch, signals: SignalMap) -> Record:
    """Return a log as one record; the displacement is zero where the log has none, and says nothing."""
    if DISPLACEMENT not in table.signals:
        table = replace(
            table,
            signals={**table.signals, DISPLACEMENT: np.zeros(table.time_s.size)},
            units={**table.units, DISPLACEMENT: model.units[DISPLACEMENT]},
        )
    record, *others = records_of(name, table, signals)
    if others:
        raise LogError(
            table.source,
            f"the commands have gaps and were split into {1 + len(others)} parts; with one initial "
            "displacement only one part can be simulated: simulate each part as its own log",
        )
    return record


def _predictions(
    model: Hitch,
    time_s: np.ndarray,
    records: Sequence[Record],
    initial: InitialValues,
    horizon: int | None,
    coverage: float | None,
) -> tuple[np.ndarray, list[str]]:
    """Return prediction and band at each row of a log, NaN outside its records; and what a model notices."""
    columns, flags = np.full((1 if coverage is None else 3, time_s.size), np.nan), []
    for record in records:
        if horizon is None:
            simulation = model.simulate(record, initial=initial.displacement, load=initial.load)
            values = [simulation.displacement, *(() if coverage is None else simulation.band(coverage))]
            flags += simulation.flags
        else:
            band = () if coverage is None else model.band(record, horizon=horizon, coverage=coverage)
            values = [model.predict(record, horizon=horizon), *band]
        # Stamps of rows lie up to half a step beside the clock of the record.
        edge = record.step_s / 2
        inside = (time_s > record.time_s[0] - edge) & (time_s < record.time_s[-1] + edge)
        columns[:, inside] = [np.interp(time_s[inside], record.time_s, series) for series in values]
    return columns, flags


def added_name(column: str, kind: str) -> str:
    """Return the name of an added column: `displacement_predicted_mm`, else `<name>_predicted`.

    Kinds are `predicted`, and `lower` and `upper` for the limits of the band.
    """
    stem, separator, unit = column.partition("displacement_")
    return f"displacement_{kind}_{unit}" if separator and not stem else f"{column}_{kind}"
