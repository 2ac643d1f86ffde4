"""From the channels of one log to records: known units, one clock, cut at gaps."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchid._support.records import Notice, short_repr
from hitchid.errors import LogError
from hitchid.logs.content import Content, LogChannel
from hitchid.logs.not_measured import sample_or_line, without_unmeasured
from hitchid.logs.record import (
    COMMAND,
    DISPLACEMENT,
    HOLD_ROLES,
    LIFTING,
    LOWERING,
    SIGNED_COMMAND,
    Record,
    held_rows,
    resampled,
)
from hitchid.logs.resampling import (
    GAP_FACTOR,
    one_sample_a_stamp,
    sections,
    spread_stamps,
    uniform,
    unique_stamp_rows,
)
from hitchid.logs.signal_map import DEFAULT_SIGNALS, DIMENSIONS, SignalColumn, SignalMap
from hitchid.logs.units import UNITS, parse_unit, unit_of_column

TIME = "time"  # role of the time among the signals of a log
MIN_SAMPLES = 20  # samples of the shortest usable stretch; chosen
CLOCK_TOLERANCE_S = 1e-9  # s; rounding of time stamps
SLOWEST_COMMAND = 10.0  # sampling times of the displacement; a slower command is held (chosen)
ON_CHANGE_STEPS = 3.0  # of the displacement; a channel logged on change is rarer (chosen)
# Of its intervals, longer or shorter than their median by a factor of 1.5: no clock, even with gaps (chosen).
ON_CHANGE_QUANTILE = 0.9


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
    # First of all: every step that follows takes stamps for finite numbers.
    content = _with_stamps(content, signals.time.column)
    source, line_of = content.source, content.line_of
    channels, names, notices = {}, {}, list(content.notices)
    for role, column in _columns_by_role(signals, content).items():
        channels[role], unit_notices = _convert_unit(content, role, column)
        names[role] = column.column
        notices += unit_notices
    time = channels.pop(TIME, None)
    displacement = channels[DISPLACEMENT].values if DISPLACEMENT in channels else np.zeros(0)
    # Before rows with one stamp are dropped, since here each of them is a sample of its own.
    if time is not None and time.values.size == displacement.size:
        spread = spread_stamps(time.values, displacement)
        if spread is not None:
            time = time._replace(values=spread[0])
            notices.append(spread[1])
    # After the units, so that notices state readings in them; before the clocks, which must not interpolate
    # towards an error code.
    given_time = time
    time, channels, not_measured = without_unmeasured(source, time, channels, names, line_of)
    stamps = None if given_time is None or time is not None else given_time.values
    if stamps is not None:  # every channel has a clock of its own now
        unique_stamp_rows(stamps, source, column=signals.time.column, line_of=line_of)
    time_s, sampled, clock_notices = resample_to_common_clock(source, time, channels, names)
    if stamps is not None:
        line_of = _line_of_rows(content, np.searchsorted(stamps, time_s))
    split = {DISPLACEMENT: sampled[DISPLACEMENT]} if DISPLACEMENT in sampled else {}
    split |= {role: values for role, values in sampled.items() if role != SIGNED_COMMAND}
    if SIGNED_COMMAND in sampled:  # positive is lifting, negative lowering
        signed = sampled[SIGNED_COMMAND]
        split |= {COMMAND[LIFTING]: np.maximum(signed, 0.0), COMMAND[LOWERING]: np.maximum(-signed, 0.0)}
    return LogTable(
        source=source,
        time_s=time_s,
        signals=split,
        units={role: channels[role if role in channels else SIGNED_COMMAND].unit or "1" for role in split},
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
        # A vector of another length, such as a table of parameters, has no rows of the time.
        if channel.values.size == stamps.size
    }
    first = sample_or_line(int(np.argmin(np.isfinite(stamps))), content.line_of)
    notice = (
        f"{stamps.size - rows.size} of {stamps.size} rows are left out, the first in {first}: "
        "they have no time stamp"
    )
    return Content(
        content.source,
        {**content.channels, **channels},
        (*content.notices, notice),
        _line_of_rows(content, rows),
    )


def _line_of_rows(content: Content, rows: np.ndarray) -> Callable[[int], int | None]:
    return lambda row: content.line_of(int(rows[row]))


def _columns_by_role(signals: SignalMap, content: Content) -> dict[str, SignalColumn]:
    """Return role to column, the time only where the log has such a channel."""
    time = signals.time if signals.time.column in content.channels else None
    if time is None and signals.time.column != DEFAULT_SIGNALS.time.column:
        # A misspelt name must not fall back to the channels' own clocks in silence.
        problem = (
            "there is no such channel, and none is needed, because every channel has its own clock: "
            "remove this line from campaign.toml, or name an existing channel as time"
        )
        raise LogError(content.source, problem, column=signals.time.column)
    columns = {
        TIME: time,
        COMMAND[LIFTING]: signals.lifting_command,
        COMMAND[LOWERING]: signals.lowering_command,
        SIGNED_COMMAND: signals.command,
        DISPLACEMENT: signals.displacement,
    }
    columns |= {column.column: column for column in signals.covariates}
    return {role: column for role, column in columns.items() if column is not None}


def _convert_unit(content: Content, role: str, column: SignalColumn) -> tuple[LogChannel, list[str]]:
    """Return a channel as (reading − zero) · scale in the unit of the signal map, and the notices."""
    name, source = column.column, content.source
    channel, name_unit = content.channels[name], unit_of_column(name)
    file_unit = parse_unit(channel.unit or "")
    declared_unit = column.unit or file_unit or name_unit or (None if role in DIMENSIONS else "1")
    if declared_unit is None:
        where = "campaign.toml" if isinstance(source, Path) else "signals"
        entry = f'{{ column = "{name}", unit = "…" }}'
        raise LogError(
            source, f"no unit in its name or in the log; give one in {where}: {entry}", column=name
        )
    dimension, dimensions = UNITS[declared_unit].dimension, DIMENSIONS.get(role)
    if dimensions and dimension not in dimensions:
        expected = f"expected one of {', '.join(dimensions)} for {role}"
        raise LogError(source, f"'{declared_unit}' is a unit of {dimension}, {expected}", column=name)
    unit, notices = "s" if role == TIME else declared_unit, []
    if column.scale is not None:
        # The scale replaces the unit of the file: a sensor in V may measure mm.
        if file_unit not in (None, declared_unit):
            notices.append(f"{name}: scaled to {declared_unit}; the unit in the log is {file_unit}")
        factor = column.scale * UNITS[declared_unit].factor / UNITS[unit].factor
        return channel._replace(values=(channel.values - column.zero) * factor, unit=unit), notices
    # Otherwise name, file and signal map must agree: nobody knows which of them is wrong.
    if file_unit and name_unit not in (None, file_unit) and UNITS[name_unit].dimension == dimension:
        problem = (
            f"the unit is '{name_unit}' in the name but '{file_unit}' in the log; expected the same unit"
        )
        raise LogError(source, problem, column=name)
    if file_unit and UNITS[file_unit].dimension != dimension:
        problem = (
            f"the unit is '{file_unit}' in the log but '{declared_unit}' in the signal map; "
            "expected units of the same quantity"
        )
        raise LogError(source, problem, column=name)
    if channel.unit and file_unit is None:
        notices.append(f"{name}: the unit '{channel.unit}' in the log is not known; read as {declared_unit}")
    elif file_unit not in (None, declared_unit):
        notices.append(f"{name}: converted from {file_unit}, the unit in the log, to {declared_unit}")
    elif file_unit is None and name_unit not in (None, declared_unit):
        notices.append(
            f"{name}: read as {declared_unit}, the unit in the signal map, although the name has another unit"
        )
    source_unit = file_unit or declared_unit
    values = channel.values - column.zero if column.zero else channel.values
    if source_unit != unit:
        values = values * (UNITS[source_unit].factor / UNITS[unit].factor)
    return channel._replace(values=values, unit=unit), notices


def resample_to_common_clock(
    source: Path | str, time: LogChannel | None, channels: Mapping[str, LogChannel], names: Mapping[str, str]
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Return time stamps, s, every channel's samples at them, and notices.

    A channel that holds the time applies to all. Otherwise each channel has a clock of its own, and all come
    to the slowest of the displacement and the commands; not counted are commands that are logged on change,
    or more than ten times slower than the displacement. Commands and what is logged on change are held, other
    signals interpolated. Samples in a gap of any channel are left out. Of samples with one time stamp a
    command takes the last, another signal the one nearest to the line through its neighbours.

    Raises:
        LogError: a channel has no clock, another length than the time, or time that decreases or is
            constant; or the channels have no time in common.
    """
    if time is not None:
        for role, channel in channels.items():
            _check_time(source, time.values, channel, names[role])
        return time.values, {role: channel.values for role, channel in channels.items()}, []
    clocks, samples = {}, {}
    for role, channel in channels.items():
        clocks[role], samples[role] = _increasing(source, role, channel, names[role])
    steps = {role: float(np.median(np.diff(clock))) for role, clock in clocks.items()}
    measured_step_s = steps.get(DISPLACEMENT, min(steps.values()))
    on_change = _logged_on_change(clocks, samples, measured_step_s)
    # What is rare beside the motion, such as an oil temperature, says nothing about how well it was sampled.
    deciding = [
        role
        for role in (DISPLACEMENT, *HOLD_ROLES)
        if role in clocks and role not in on_change and steps[role] <= SLOWEST_COMMAND * measured_step_s
    ]
    # The slowest, since no channel must be made up between its samples; interpolation only thins out.
    reference = max(deciding, key=lambda role: steps[role], default=min(steps, key=lambda role: steps[role]))
    target = clocks[reference]
    others = {role for role, clock in clocks.items() if not np.array_equal(clock, target)}
    if not others:
        return target, samples, []
    mask = _common_instants(clocks, steps, reference, others, on_change)
    if not mask.any():
        raise LogError(source, "the time ranges of the channels do not overlap")
    target = target[mask]
    for role, values in samples.items():
        if role not in others:
            samples[role] = values[mask]
        # A valve never sees a value between two commands; nor has a state, such as a gear, one.
        elif role in on_change or role in HOLD_ROLES:
            samples[role] = values[held_rows(clocks[role], target)]
        else:
            samples[role] = np.interp(target, clocks[role], values)
    notices = []
    if len(set(steps.values())) > 1 or not all(np.all(np.isin(target, clocks[role])) for role in others):
        steps_text = ", ".join(f"{names[role]} {step_s:.4g} s" for role, step_s in steps.items())
        notices.append(f"resampled to the clock of {names[reference]}: {steps_text}")
    notices += [
        f"{names[role]} is sampled every {steps[role]:.3g} s, {names[reference]} every "
        f"{steps[reference]:.3g} s: dead times are known no better than that"
        for role in HOLD_ROLES
        if role in others - on_change and steps[role] > SLOWEST_COMMAND * steps[reference]
    ]
    return target, samples, notices


def _check_time(source: Path | str, time_s: np.ndarray, channel: LogChannel, name: str) -> None:
    """Refuse a time of another length or duration than the channel and its own clock have."""
    clock, size = channel.clock_s, channel.values.size
    if size != time_s.size:
        raise LogError(source, f"has {size} samples, expected {time_s.size} as the time", column=name)
    if clock is None or clock.size < 2:
        return
    clock_duration_s, time_duration_s = float(clock[-1] - clock[0]), float(time_s[-1] - time_s[0])
    # Their origins may differ, for a clock counts from its own start; their lengths may not.
    if not abs(clock_duration_s - time_duration_s) <= abs(time_duration_s) / (clock.size - 1):
        problem = f"lasts {clock_duration_s:g} s on its own clock, {time_duration_s:g} s on the time channel"
        raise LogError(
            source, f"{problem}; name the time channel of its own group in campaign.toml", column=name
        )


def _increasing(
    source: Path | str, role: str, channel: LogChannel, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return clock and samples of a channel, one sample a stamp."""
    clock, values = channel.clock_s, channel.values
    if clock is None:
        problem = 'has no clock in the file; name the time channel in campaign.toml: time = "…"'
        raise LogError(source, problem, column=name)
    if clock.size < 2:
        raise LogError(source, f"has {clock.size} samples, expected at least 2", column=name)
    rows = unique_stamp_rows(clock, source, column=name, line_of=lambda _: None)
    if rows.size == clock.size:
        return clock, values
    return clock[rows], one_sample_a_stamp(values, clock, rows, is_held=role in HOLD_ROLES)


def _logged_on_change(
    clocks: Mapping[str, np.ndarray], samples: Mapping[str, np.ndarray], measured_step_s: float
) -> set[str]:
    """Return the channels that were written when they changed, so that each sample holds until the next.

    Their samples are rarer than the displacement's, and irregular; a command's may also never repeat, but in
    the sample that closes the log.
    """
    on_change = set()
    for role in clocks.keys() - {DISPLACEMENT}:
        intervals = np.diff(clocks[role])
        step_s = float(np.median(intervals))
        shorter, longer = np.quantile(intervals, [1 - ON_CHANGE_QUANTILE, ON_CHANGE_QUANTILE])
        # A slow but regular channel is sampled, not written on change, and is no step function.
        is_irregular = longer > GAP_FACTOR * step_s or step_s > GAP_FACTOR * shorter
        # A logger on change writes only new values, and often the last one again when it stops.
        never_repeats = role in HOLD_ROLES and np.all(np.diff(samples[role][:-1]))
        if step_s > ON_CHANGE_STEPS * measured_step_s and (is_irregular or never_repeats):
            on_change.add(role)
    return on_change


def _common_instants(
    clocks: Mapping[str, np.ndarray],
    steps: Mapping[str, float],
    reference: str,
    others: Collection[str],
    on_change: Collection[str],
) -> np.ndarray:
    """Return at which instants of the reference clock every other channel is known, shape [N]."""
    target = clocks[reference]
    mask = np.ones(target.size, dtype=bool)
    for role in others:
        clock, step_s = clocks[role], max(steps[role], steps[reference])
        # Motion is not made up beyond its samples; a slow covariate hardly changes within one of its steps.
        is_slow = steps[role] > steps[reference]
        slack_s = step_s / 2 if role in HOLD_ROLES else step_s if is_slow else CLOCK_TOLERANCE_S
        mask &= target >= clock[0] - slack_s
        if role in on_change:  # each sample holds until the next, the last one to the end
            continue
        after = np.clip(np.searchsorted(clock, target), 1, clock.size - 1)
        nearest_s = np.minimum(np.abs(target - clock[after]), np.abs(target - clock[after - 1]))
        mask &= (clock[after] - clock[after - 1] <= GAP_FACTOR * step_s) | (nearest_s <= CLOCK_TOLERANCE_S)
        mask &= target <= clock[-1] + slack_s
    return mask


# From the table of one log to records: cut at gaps, resampled where time stamps are irregular.


def records_of(name: str, table: LogTable, signals: SignalMap) -> list[Record]:
    """Return a record for each stretch of a log without a gap, `name` or `name@1`, `name@2`, …."""
    source, time_s, samples = table.source, table.time_s, table.signals
    rows = unique_stamp_rows(time_s, source, column=signals.time.column, line_of=table.line_of)
    repeated = time_s.size - rows.size
    if repeated:
        samples = {
            role: one_sample_a_stamp(values, time_s, rows, is_held=role in COMMAND.values())
            for role, values in samples.items()
        }
        time_s = time_s[rows]
    # Whether a gap may be bridged depends on what commands and piston do about it.
    commands = {role: values for role, values in samples.items() if role in COMMAND.values()}
    all_sections = sections(time_s, commands, samples[DISPLACEMENT])
    usable = [section for section in all_sections if section.stop - section.start >= MIN_SAMPLES]
    if not usable:
        longest = max((section.stop - section.start for section in all_sections), default=time_s.size)
        raise LogError(
            source, f"the longest part without gaps has {longest} samples, expected at least {MIN_SAMPLES}"
        )
    records = []
    for number, section in enumerate(usable, start=1):
        stamps = time_s[section.start : section.stop]
        cut = {role: values[section.start : section.stop] for role, values in samples.items()}
        record = Record(
            name=name if len(usable) == 1 else f"{name}@{number}",
            step_s=section.step_s,
            signals=resampled(cut, stamps, uniform(stamps, section.step_s)) if section.resampled else cut,
            units=table.units,
            start_s=float(stamps[0]),
            # A table in memory has a name only: a path that is no file would be shown as one.
            source=source if isinstance(source, Path) else None,
            notices=section.notices,
            clock=section.clock,
        )
        records.append(record)
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
    # What concerns the whole log is said once.
    records[0] = replace(records[0], notices=(*records[0].notices, *notices))
    return records
