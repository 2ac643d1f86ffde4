"""A log's signals on one clock and in known units."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.data.record import COMMAND, DISPLACEMENT, LIFTING, LOWERING
from hitchid.data.signal_map import DEFAULT_SIGNALS, DIMENSIONS, Column, SignalMap
from hitchid.data.units import UNITS, known_unit, unit_of_column
from hitchid.errors import LogError
from hitchid.readers.clocks import SIGNED, on_one_clock
from hitchid.readers.content import Channel, Content

TIME = "time"


@dataclass(frozen=True)
class Table:
    """The signals of one log.

    Attributes:
        source: the file.
        time_s: time stamps, s, shape [N].
        signals: role to samples, each of shape [N].
        units: role to unit.
        columns: the columns they come from, in the order of the signal map.
        notices: what the user should know of how they were read.
        line_of: from a sample to its line in the file, None where the format has no lines.
    """

    source: Path
    time_s: np.ndarray
    signals: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    columns: Mapping[str, np.ndarray]
    notices: tuple[str, ...]
    line_of: Callable[[int], int | None]


def table_of(content: Content, signals: SignalMap) -> Table:
    """Return what a reader handed over as signals: in one unit each, on one clock.

    What the file says of a unit counts: a signal map in another unit of the same dimension has the numbers
    converted, with a notice; one of another dimension is refused, and so is a name that contradicts the file.
    Channels with clocks of their own are taken to the slowest of them.

    Raises:
        LogError: a unit is missing or contradicted, a channel holds what is no number, or the clocks do not
            fit together.
    """
    mapped = _mapped(signals, content)
    if TIME not in mapped and signals.time.column != DEFAULT_SIGNALS.time.column:
        problem = "there is no such channel; the file keeps clocks of its own, so leave the time out"
        raise LogError(content.source, problem, column=signals.time.column)
    converted, notices = {}, list(content.notices)
    for role, column in mapped.items():
        converted[role], said = _converted(content, role, column)
        notices += said
    time = converted.pop(TIME, None)
    names = {role: column.column for role, column in mapped.items() if role != TIME}
    time_s, sampled, merged = on_one_clock(content.source, time, converted, names)
    return Table(
        source=content.source,
        time_s=time_s,
        signals=_by_mode(sampled),
        units=_by_mode({role: channel.unit or "1" for role, channel in converted.items()}),
        columns={names[role]: values for role, values in sampled.items()},
        notices=(*notices, *merged),
        line_of=content.line_of,
    )


def _mapped(signals: SignalMap, content: Content) -> dict[str, Column]:
    """Return role to column, the time only where the log has such a channel."""
    covariates = {column.column: column for column in signals.covariates}
    given = {
        TIME: signals.time if signals.time.column in content.channels else None,
        COMMAND[LIFTING]: signals.lifting_command,
        COMMAND[LOWERING]: signals.lowering_command,
        SIGNED: signals.command,
        DISPLACEMENT: signals.displacement,
    }
    return {**{role: column for role, column in given.items() if column is not None}, **covariates}


def _converted(content: Content, role: str, column: Column) -> tuple[Channel, list[str]]:
    """Return a channel in the unit it is asked in, (reading − zero) · scale, and what was done to it."""
    name, source = column.column, content.source
    channel = content.channels[name]
    _check_finite(content, name)
    said = known_unit(channel.unit or "")
    asked = column.unit or said or unit_of_column(name) or (None if role in DIMENSIONS else "1")
    if asked is None:
        raise LogError(
            source,
            "neither its name nor the file says its unit; "
            f'required {{ column = "{name}", unit = "…" }} in campaign.toml',
            column=name,
        )
    _check_dimension(source, role, name, asked)
    unit = "s" if role == TIME else asked
    if column.scale is not None:
        # The scale says what a reading is worth, whatever unit the file gives it.
        factor = column.scale * UNITS[asked].factor / UNITS[unit].factor
        notices = [] if said in (None, asked) else [f"{name}: scaled to {asked}; the file's unit is {said}"]
        return channel._replace(values=(channel.values - column.zero) * factor, unit=unit), notices
    _check_agrees(source, name, asked, said)
    notices = []
    if channel.unit and said is None:
        notices.append(f"{name}: the unit '{channel.unit}' in the file is not known; read as {asked}")
    elif said not in (None, asked):
        notices.append(f"{name}: converted from {said}, as the file says, to {asked}")
    elif said is None and unit_of_column(name) not in (None, asked):
        notices.append(f"{name}: read as {asked}, as the signal map says, although its name ends otherwise")
    had = said or asked
    factor = 1.0 if had == unit else UNITS[had].factor / UNITS[unit].factor
    values = channel.values - column.zero if column.zero else channel.values
    values = values if factor == 1.0 else values * factor
    return channel._replace(values=values, unit=unit), notices


def _check_dimension(source: Path, role: str, name: str, asked: str) -> None:
    dimension, dimensions = UNITS[asked].dimension, DIMENSIONS.get(role)
    if dimensions and dimension not in dimensions:
        raise LogError(
            source,
            f"'{asked}' is a unit of {dimension}, required one of {', '.join(dimensions)} for {role}",
            column=name,
        )


def _check_agrees(source: Path, name: str, asked: str, said: str | None) -> None:
    """Refuse a unit that the file says in its name and beside it, or as the map, in two ways."""
    if said is None:
        return
    dimension = UNITS[asked].dimension
    named = unit_of_column(name)
    if named not in (None, said) and UNITS[named].dimension == dimension:
        problem = f"the name says '{named}', the file '{said}'; required one of them to be put right"
        raise LogError(source, problem, column=name)
    if UNITS[said].dimension != dimension:
        raise LogError(
            source, f"the file says '{said}', the signal map '{asked}': no units of one kind", column=name
        )


def _check_finite(content: Content, name: str) -> None:
    values = content.channels[name].values
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise LogError(
            content.source,
            f"required finite numbers, came {values[bad[0]]} ({bad.size} such of {values.size} samples, "
            f"the first at sample {bad[0]})",
            line=content.line_of(int(bad[0])),
            column=name,
        )


def _by_mode(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return roles with a signed command taken apart: lifting above zero, lowering below; units likewise."""
    first = {DISPLACEMENT: given[DISPLACEMENT]}
    roles = first | {role: value for role, value in given.items() if role != SIGNED}
    if SIGNED not in given:
        return roles
    signed = given[SIGNED]
    if isinstance(signed, str):
        return {**roles, COMMAND[LIFTING]: signed, COMMAND[LOWERING]: signed}
    return {**roles, COMMAND[LIFTING]: np.maximum(signed, 0.0), COMMAND[LOWERING]: np.maximum(-signed, 0.0)}
