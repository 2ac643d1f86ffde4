"""A log's signals on one clock and in known units."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchid._support.records import Notice, short_repr
from hitchid.errors import LogError
from hitchid.logs.clocks import SIGNED_COMMAND, resample_to_common_clock
from hitchid.logs.content import Content, LogChannel
from hitchid.logs.not_measured import without_unmeasured
from hitchid.logs.record import COMMAND, DISPLACEMENT, LIFTING, LOWERING, Record, resampled
from hitchid.logs.resampling import (
    LogSection,
    one_sample_a_stamp,
    sections,
    spread_stamps,
    uniform,
    unique_stamp_rows,
)
from hitchid.logs.signal_map import DEFAULT_SIGNALS, DIMENSIONS, Column, SignalMap
from hitchid.logs.units import UNITS, parse_unit, unit_of_column

TIME = "time"  # role of the time among the signals of a log


@short_repr
@dataclass(frozen=True)
class LogTable:
    """The signals of one log.

    Attributes:
        source: the file, or the name of a table in memory.
        time_s: time stamps, s, shape [N].
        signals: role to samples, each of shape [N].
        units: role to unit.
        columns: the columns they come from, in the order of the signal map.
        notices: messages on conversions, resampling and left-out samples.
        not_measured: notices of samples that no sensor measured.
        line_of: from a sample to its line in the file, None for a format without lines.
    """

    source: Path | str
    time_s: np.ndarray
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    columns: Mapping[str, np.ndarray]
    notices: tuple[str, ...]
    line_of: Callable[[int], int | None]
    not_measured: tuple[Notice, ...] = ()


def table_of(content: Content, signals: SignalMap) -> LogTable:
    """Return the channels of a log as signals: in one unit each, on one clock.

    The unit in the file has precedence. Where the signal map gives another unit of the same dimension, the
    numbers are converted, with a notice. A unit of another dimension and a name that contradicts the file are
    refused. Channels with clocks of their own come to that of the motion, as `resample_to_common_clock` says.

    Raises:
        LogError: a unit is missing or contradictory, a channel holds no number, or the clocks do not overlap.
    """
    content = _with_stamps(content, signals.time.column)
    columns = _columns_by_role(signals, content)
    if TIME not in columns and signals.time.column != DEFAULT_SIGNALS.time.column:
        problem = (
            "there is no such channel, and none is needed, because every channel has its "
            "own clock: remove this line from campaign.toml, or name an existing channel "
            "as time"
        )
        raise LogError(content.source, problem, column=signals.time.column)
    converted, notices = {}, list(content.notices)
    for role, column in columns.items():
        converted[role], unit_notices = _convert_unit(content, role, column)
        notices += unit_notices
    time = converted.pop(TIME, None)
    displacement = converted[DISPLACEMENT].values if DISPLACEMENT in converted else np.zeros(0)
    if time is not None and time.values.size == displacement.size:
        spread = spread_stamps(time.values, displacement)
        if spread is not None:
            time = time._replace(values=spread[0])
            notices.append(spread[1])
    names = {role: column.column for role, column in columns.items() if role != TIME}
    given_time, line_of = time, content.line_of
    time, converted, not_measured = without_unmeasured(content.source, time, converted, names, line_of)
    if given_time is not None and time is None:
        unique_stamp_rows(given_time.values, content.source, column=signals.time.column, line_of=line_of)
    time_s, sampled, clock_notices = resample_to_common_clock(content.source, time, converted, names)
    if given_time is not None and time is None:
        rows = np.searchsorted(given_time.values, time_s)
        line_of = _line_of_rows(content, rows)
    split = _split_signed_command(sampled)
    return LogTable(
        source=content.source,
        time_s=time_s,
        signals=split,
        units={role: converted[role if role in converted else SIGNED_COMMAND].unit or "1" for role in split},
        columns={names[role]: values for role, values in sampled.items()},
        notices=(*notices, *clock_notices),
        line_of=line_of,
        not_measured=tuple(not_measured),
    )


def _with_stamps(content: Content, time: str) -> Content:
    """Return a log without the rows whose time stamp is missing."""
    stamps = content.channels[time].values if time in content.channels else np.zeros(0)
    rows = np.flatnonzero(np.isfinite(stamps))
    if rows.size == stamps.size:
        return content
    if not rows.size:
        problem = f"expected finite time stamps, got {stamps[0]} in all {stamps.size} samples"
        raise LogError(content.source, problem, line=content.line_of(0), column=time)
    channels = {
        name: channel._replace(
            values=channel.values[rows], clock_s=None if channel.clock_s is None else channel.clock_s[rows]
        )
        for name, channel in content.channels.items()
        if channel.values.size == stamps.size
    }
    first = int(np.argmin(np.isfinite(stamps)))
    line = content.line_of(first)
    notice = (
        f"{stamps.size - rows.size} of {stamps.size} rows are left out, the first in "
        f"{f'sample {first}' if line is None else f'line {line}'}: they have no time stamp"
    )
    return Content(
        content.source,
        {**content.channels, **channels},
        (*content.notices, notice),
        _line_of_rows(content, rows),
    )


def _line_of_rows(content: Content, rows: np.ndarray) -> Callable[[int], int | None]:
    return lambda row: content.line_of(int(rows[row]))


def _columns_by_role(signals: SignalMap, content: Content) -> dict[str, Column]:
    """Return role to column, the time only where the log has such a channel."""
    covariates = {column.column: column for column in signals.covariates}
    all_columns = {
        TIME: signals.time if signals.time.column in content.channels else None,
        COMMAND[LIFTING]: signals.lifting_command,
        COMMAND[LOWERING]: signals.lowering_command,
        SIGNED_COMMAND: signals.command,
        DISPLACEMENT: signals.displacement,
    }
    return {**{role: column for role, column in all_columns.items() if column is not None}, **covariates}


def _convert_unit(content: Content, role: str, column: Column) -> tuple[LogChannel, list[str]]:
    """Return a channel as (reading − zero) · scale in the unit of the signal map, and the notices."""
    name, source = column.column, content.source
    channel = content.channels[name]
    file_unit = parse_unit(channel.unit or "")
    declared_unit = column.unit or file_unit or unit_of_column(name) or (None if role in DIMENSIONS else "1")
    if declared_unit is None:
        raise LogError(
            source,
            "no unit in its name or in the log; "
            f'give one in {content.map_place}: {{ column = "{name}", unit = "…" }}',
            column=name,
        )
    _check_dimension(source, role, name, declared_unit)
    unit = "s" if role == TIME else declared_unit
    if column.scale is not None:
        # The scale replaces the unit of the file.
        factor = column.scale * UNITS[declared_unit].factor / UNITS[unit].factor
        notices = (
            []
            if file_unit in (None, declared_unit)
            else [f"{name}: scaled to {declared_unit}; the unit in the log is {file_unit}"]
        )
        return channel._replace(values=(channel.values - column.zero) * factor, unit=unit), notices
    _check_agrees(source, name, declared_unit, file_unit)
    notices = []
    if channel.unit and file_unit is None:
        notices.append(f"{name}: the unit '{channel.unit}' in the log is not known; read as {declared_unit}")
    elif file_unit not in (None, declared_unit):
        notices.append(f"{name}: converted from {file_unit}, the unit in the log, to {declared_unit}")
    elif file_unit is None and unit_of_column(name) not in (None, declared_unit):
        notices.append(
            f"{name}: read as {declared_unit}, the unit in the signal map, although the name has another unit"
        )
    source_unit = file_unit or declared_unit
    factor = 1.0 if source_unit == unit else UNITS[source_unit].factor / UNITS[unit].factor
    values = channel.values - column.zero if column.zero else channel.values
    values = values if factor == 1.0 else values * factor
    return channel._replace(values=values, unit=unit), notices


def _check_dimension(source: Path | str, role: str, name: str, declared_unit: str) -> None:
    dimension, dimensions = UNITS[declared_unit].dimension, DIMENSIONS.get(role)
    if dimensions and dimension not in dimensions:
        raise LogError(
            source,
            f"'{declared_unit}' is a unit of {dimension}, expected one of {', '.join(dimensions)} for {role}",
            column=name,
        )


def _check_agrees(source: Path | str, name: str, declared_unit: str, file_unit: str | None) -> None:
    """Refuse a unit of the file that contradicts the column's name or the signal map."""
    if file_unit is None:
        return
    dimension = UNITS[declared_unit].dimension
    name_unit = unit_of_column(name)
    if name_unit not in (None, file_unit) and UNITS[name_unit].dimension == dimension:
        problem = (
            f"the unit is '{name_unit}' in the name but '{file_unit}' in the log; expected the same unit"
        )
        raise LogError(source, problem, column=name)
    if UNITS[file_unit].dimension != dimension:
        raise LogError(
            source,
            f"the unit is '{file_unit}' in the log but '{declared_unit}' in the signal map; "
            "expected units of the same quantity",
            column=name,
        )


def _split_signed_command(samples: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return role to samples with a signed command split: positive is lifting, negative lowering."""
    displacement = {DISPLACEMENT: samples[DISPLACEMENT]} if DISPLACEMENT in samples else {}
    split = displacement | {role: values for role, values in samples.items() if role != SIGNED_COMMAND}
    if SIGNED_COMMAND in samples:
        signed = samples[SIGNED_COMMAND]
        split |= {COMMAND[LIFTING]: np.maximum(signed, 0.0), COMMAND[LOWERING]: np.maximum(-signed, 0.0)}
    return split


# From the table of one log to records: cut at gaps, resampled where time stamps are irregular.

MIN_SAMPLES = 20  # samples of the shortest usable stretch; chosen


def records_of(name: str, table: LogTable, signals: SignalMap) -> list[Record]:
    """Return a record for each stretch of a log without a gap, `name` or `name@1`, `name@2`, ….

    Raises:
        LogError: the clock cannot be used, or no stretch is long enough.
    """
    source, column = table.source, signals.time.column
    rows = unique_stamp_rows(table.time_s, source, column=column, line_of=table.line_of)
    repeated = table.time_s.size - rows.size
    table = _one_row_a_stamp(table, rows) if repeated else table
    time_s = table.time_s
    commands = {role: values for role, values in table.signals.items() if role in COMMAND.values()}
    all_sections = sections(time_s, commands, table.signals[DISPLACEMENT])
    usable = [section for section in all_sections if section.stop - section.start >= MIN_SAMPLES]
    if not usable:
        longest = max((section.stop - section.start for section in all_sections), default=time_s.size)
        raise LogError(
            source, f"the longest part without gaps has {longest} samples, expected at least {MIN_SAMPLES}"
        )
    records = [
        _record(name if len(usable) == 1 else f"{name}@{number}", table, section)
        for number, section in enumerate(usable, start=1)
    ]
    notices = [*table.not_measured, *(Notice("as-read", sentence) for sentence in table.notices)]
    if repeated:
        sentence = f"{repeated} rows are left out: they repeat the time stamp of the previous row"
        notices.append(Notice("rows-left-out", sentence))
    left_out = time_s.size - sum(section.stop - section.start for section in usable)
    if left_out:
        sentence = (
            f"{left_out} of {time_s.size} samples are left out: parts shorter than {MIN_SAMPLES} samples"
        )
        notices.append(Notice("samples-left-out", sentence))
    records[0] = replace(records[0], notices=(*records[0].notices, *notices))
    return records


def _one_row_a_stamp(table: LogTable, rows: np.ndarray) -> LogTable:
    samples = {
        role: one_sample_a_stamp(values, table.time_s, rows, is_held=role in COMMAND.values())
        for role, values in table.signals.items()
    }
    return replace(table, time_s=table.time_s[rows], signals=samples)


def _record(name: str, table: LogTable, section: LogSection) -> Record:
    stamps = table.time_s[section.start : section.stop]
    samples = {role: values[section.start : section.stop] for role, values in table.signals.items()}
    if section.resampled:
        samples = resampled(samples, stamps, uniform(stamps, section.step_s))
    return Record(
        name=name,
        step_s=section.step_s,
        signals=samples,
        units=table.units,
        start_s=float(stamps[0]),
        source=table.source if isinstance(table.source, Path) else None,
        notices=section.notices,
        clock=section.clock,
    )
