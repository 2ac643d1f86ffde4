"""From the table of one log to records: cut at gaps, resampled where time stamps are irregular."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from hitchid._support.notices import Notice
from hitchid.data.log_table import LogTable
from hitchid.data.record import COMMAND, DISPLACEMENT, Record, resampled
from hitchid.data.resampling import LogSection, one_sample_a_stamp, sections, uniform, unique_stamp_rows
from hitchid.data.signal_map import SignalMap
from hitchid.errors import LogError

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
