"""From tables of pandas or polars to records, and from records to tables of pandas."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from hitchid._support import checks
from hitchid.errors import InputError, LogError
from hitchid.logs.content import Content, LogChannel
from hitchid.logs.kinds import detect_kind, full_scales
from hitchid.logs.log_table import records_of, table_of
from hitchid.logs.record import COMMAND, DISPLACEMENT, KINDS, LIFTING, LOWERING, Record
from hitchid.logs.signal_map import DEFAULT_SIGNALS, SignalColumn, SignalMap, signal_map_of
from hitchid.logs.unification import LeftOut, refuse, split_usable
from hitchid.logs.units import UNITS, parse_unit, unit_of_column

if TYPE_CHECKING:
    import pandas

TIME = "time"
# Beginning of a column's name, before its unit, to its signal, where no signal map is given.
STEMS = {role: role for role in (TIME, DISPLACEMENT, "command", *COMMAND.values())}
STEMS |= {"current_up": COMMAND[LIFTING], "current_down": COMMAND[LOWERING]}


@runtime_checkable
class Frame(Protocol):
    """What a table must have; a column has `to_numpy()`."""

    columns: Any

    def __getitem__(self, name: str, /) -> Any:
        """Return a column."""


def record_from_dataframe(
    frame: object,
    *,
    name: str,
    signals: Mapping[str, object] | None,
    units: Mapping[str, str] | None,
    kind: str | None,
) -> Record:
    """Return the record of a table; see `Record.from_dataframe`."""
    checks.instance(name, str, "name", "text")
    records = _read_frame(name, _checked_frame(frame, "frame"), signals, _checked_units(units))
    # One record was asked for: to choose the longest part in silence would lose data.
    if len(records) > 1:
        raise InputError(
            f"{name}: long gaps divide the table into {len(records)} sections, expected one; "
            "use Campaign.from_dataframes, which makes a record of each"
        )
    (record,) = records
    if kind is None:
        return replace(record, kind=detect_kind(record, full_scales(records)))
    return replace(record, kind=checks.one_of(kind, KINDS, "kind"))


def read_frames(
    frames: Mapping[str, object] | Iterable[object],
    signals: Mapping[str, object] | None,
    units: Mapping[str, str] | None,
    *,
    strict: bool,
) -> tuple[list[Record], list[LeftOut]]:
    """Return the records of tables, and the tables that cannot be used; see `Campaign.from_dataframes`."""
    # Iterated over, a table gives the names of its columns, each of which would be taken for a log.
    if isinstance(frames, Frame):
        raise checks.input_error("frames", "a list of tables, or name to table", frames)
    if not isinstance(frames, Mapping):
        tables = checks.tuple_of(frames, object, "frames", "tables, or name to table")
        frames = {f"test-{number}": table for number, table in enumerate(tables, start=1)}
    named = {
        checks.instance(name, str, "frames: name", "text"): _checked_frame(frame, f"frames: '{name}'")
        for name, frame in frames.items()
    }
    checked_units = _checked_units(units)
    records_by_frame, left_out = split_usable(
        ((name, (name, frame)) for name, frame in named.items()),
        lambda item: _read_frame(*item, signals, checked_units),
        strict=strict,
    )
    records = [record for records in records_by_frame for record in records]
    if left_out and not records:
        refuse(left_out, "tables")
    return records, left_out


def to_dataframe(record: Record) -> "pandas.DataFrame":
    """Return a table of time and signals; see `Record.to_dataframe`."""
    try:
        import pandas
    except ImportError as error:
        raise InputError("pandas is required for a table: pip install 'hitchid[pandas]'") from error
    roles = (DISPLACEMENT, *COMMAND.values())
    ordered = [
        *(role for role in roles if role in record.signals),
        *(r for r in record.signals if r not in roles),
    ]
    columns = {DEFAULT_SIGNALS.time.column: record.time_s}
    for role in ordered:
        # The name has the unit only where it can be read from its end.
        unit, name = record.units[role], f"{role}_{record.units[role]}"
        is_read = unit_of_column(name) == unit and unit_of_column(role) != unit
        columns[name if is_read else role] = record.signals[role]
    return pandas.DataFrame(columns)


def _checked_frame(frame: object, where: str) -> Frame:
    if not isinstance(frame, Frame):
        raise checks.input_error(where, "a table of pandas or polars", frame)
    return frame


def _checked_units(units: Mapping[str, str] | None) -> dict[str, str]:
    checked = dict(checks.instance(units or {}, Mapping, "units", "column to unit"))
    for column, unit in checked.items():
        if not isinstance(unit, str) or parse_unit(unit) is None:
            raise checks.input_error(f"units: column '{column}'", f"one of {', '.join(UNITS)}", unit)
    return checked


def _read_frame(
    name: str, frame: Frame, given: Mapping[str, object] | None, units: Mapping[str, str]
) -> list[Record]:
    """Return a record for each stretch of a table without a gap."""
    columns = [column for column in frame.columns if isinstance(column, str)]
    signals = _map_by_name(name, columns) if given is None else signal_map_of(given)
    # A unit for a column that is not there is a misspelt name, whose column would be read without it.
    for column in units:
        if column not in columns and column != getattr(getattr(frame, "index", None), "name", None):
            problem = f"`units` names it, but there is no such column; found {', '.join(columns)}"
            raise LogError(name, problem, column=column)
    channels = {signals.time.column: _time(name, frame, columns, signals.time, units)}
    for column in signals.measured:
        if column not in columns:
            problem = (
                "there is no such column; expected this column in the table, or another name "
                f"in `signals`; found {', '.join(columns)}"
            )
            raise LogError(name, problem, column=column)
        channels[column] = _column(frame[column], name, column, units.get(column))
    return records_of(name, table_of(Content(name, channels), signals), signals)


def _map_by_name(name: str, columns: Iterable[str]) -> SignalMap:
    """Return the signal map of columns that are named after their signal and unit."""
    column_of: dict[str, str] = {}
    for column in columns:
        unit = unit_of_column(column)
        signal = STEMS.get(column if unit is None else column.rpartition("_")[0])
        # A guess between two columns would give a model of the wrong one.
        if signal in column_of:
            both = f"the columns '{column_of[signal]}' and '{column}' both match {signal}"
            raise LogError(name, f"{both}; expected `signals` to name one of them")
        if signal is not None:
            column_of[signal] = column
    if not column_of.keys() & {"command", *COMMAND.values()}:
        problem = (
            "no column is named as a command; expected current_up_A and current_down_A, or `signals`, "
            f"a dict as [signals] in campaign.toml; found {', '.join(columns) or 'no columns'}"
        )
        raise LogError(name, problem)
    return signal_map_of(column_of)


def _time(
    name: str, frame: Frame, columns: list[str], time: SignalColumn, units: Mapping[str, str]
) -> LogChannel:
    """Return the time: its column, else the index of a table of pandas."""
    if time.column in columns:
        return _column(frame[time.column], name, time.column, units.get(time.column))
    index = getattr(frame, "index", None)
    is_default = time == DEFAULT_SIGNALS.time
    if index is not None and (is_default or index.name == time.column):
        label = index.name if isinstance(index.name, str) else "index"
        # Whole numbers are most often those of the rows, unless the name of the index is one of a time.
        is_time = index.name == time.column or (unit_of_column(label) or units.get(label)) is not None
        if is_time or np.asarray(index.to_numpy()).dtype.kind not in "iu":
            return _column(index, name, label, units.get(label) or unit_of_column(label))
    problem = (
        "there is no such column, and the index is not a time; expected this column, a "
        "time index, or the name of the time column in `signals`; found "
        f"{', '.join(columns)}"
    )
    raise LogError(name, problem, column=time.column)


def _column(column: Any, name: str, label: str, unit: str | None) -> LogChannel:
    """Return a column as doubles in its unit: dates as seconds since the first, durations as seconds."""
    values = np.asarray(column.to_numpy())
    # pandas returns a table for a name that several columns share.
    if values.ndim != 1:
        raise LogError(name, "several columns have this name", column=label)
    if values.dtype.kind == "c":
        raise LogError(name, "expected real numbers, got complex ones", column=label)
    if values.dtype.kind in "Mm":
        valid = np.flatnonzero(~np.isnat(values))
        # Dates count from the first, a double cannot hold ns since 1970; durations have a zero of their own.
        zero = values[valid[0]] if values.dtype.kind == "M" and valid.size else np.timedelta64(0, "ns")
        return LogChannel((values - zero) / np.timedelta64(1, "s"), "s")
    if values.dtype.kind == "O" and values.size and all(isinstance(item, datetime) for item in values):
        try:
            seconds = [(item - values[0]).total_seconds() for item in values]
        except TypeError as error:
            raise LogError(name, "some dates have a time zone, others have none", column=label) from error
        return LogChannel(np.array(seconds), "s")  # dates with a time zone
    try:
        return LogChannel(np.array(values, dtype=np.float64), unit)
    except (TypeError, ValueError) as error:
        problem = f"expected numbers, got {values.dtype} such as {values[0]!r}"
        raise LogError(name, problem, column=label) from error
