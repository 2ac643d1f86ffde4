"""The one way in: `read` takes files and folders and returns a campaign."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path

import numpy as np

from hitchid._support import checks
from hitchid.data.campaign import Campaign
from hitchid.data.left_out import LeftOut, refuse, sift
from hitchid.data.record import COMMAND, DISPLACEMENT, Record, resampled
from hitchid.data.resampling import Section, first_of_each_stamp, sections, uniform
from hitchid.data.signal_map import CampaignFile, SignalMap
from hitchid.errors import LogError
from hitchid.readers.content import Content, Wanted
from hitchid.readers.folders import find_logs, settings_of
from hitchid.readers.formats import format_of, known_format, record_name
from hitchid.readers.process import ReaderProcess
from hitchid.readers.table import Table, table_of

SHORTEST = 20
LOGS = "files and folders of logs"


def read(
    logs: str | Path | Iterable[str | Path],
    *,
    signals: str | Path | None = None,
    strict: bool = False,
) -> Campaign:
    """Read logs into a campaign; those that cannot be used are left out, see `Campaign.left_out`.

    Args:
        logs: files and folders of any known format.
        signals: a file like `campaign.toml`; without it each folder's own is used, or the default columns
            `time_s, current_up_A, current_down_A, displacement_mm`.
        strict: whether one log that cannot be used is an error for all.

    Returns:
        One record a test, a log with gaps giving several, on one clock and in one set of units.

    Raises:
        LogError: no log can be used.
        SettingsError: a settings file cannot be used.
        InputError: there are no logs, or none of a direction can be used.
    """
    given = logs if isinstance(logs, str | Path) else checks.several(logs, (str, Path), "logs", LOGS)
    paths = find_logs(given)
    settings = settings_of(paths, None if signals is None else checks.path(signals, "signals"))
    records, left_out = read_logs(paths, settings, strict=strict)
    if not records:
        refuse(left_out, "logs")
    return assemble(records, settings, left_out, strict=strict)


def read_logs(
    paths: Sequence[Path], settings: Mapping[Path, CampaignFile], *, strict: bool = False
) -> tuple[list[Record], list[LeftOut]]:
    """Read logs one by one; return their records, and the logs that cannot be read.

    Raises:
        LogError: with `strict`, a log cannot be read.
    """
    names = [record_name(path) if known_format(path) else path.name for path in paths]
    with ReaderProcess() as process:
        found, left_out = sift(
            zip(names, paths, strict=True),
            lambda path: read_log(path, settings[path.parent], process),
            strict=strict,
        )
    return [record for records in found for record in records], left_out


def assemble(
    records: Sequence[Record],
    settings: Mapping[Path, CampaignFile],
    left_out: Sequence[LeftOut] = (),
    *,
    strict: bool = False,
) -> Campaign:
    """Make a campaign of records and what the settings of each one's folder say of split and kinds.

    Args:
        records: tests.
        settings: of each folder.
        left_out: logs that could not be read; a pattern that matches one of them is not misspelt.
        strict: see `Campaign.of`.

    Raises:
        InputError, LogError: as `Campaign.of`.
    """
    named = _distinct(records)
    held_out, kinds, matched = [], {}, set()
    for record, own in zip(records, named, strict=True):
        said = settings[record.source.parent] if record.source is not None else CampaignFile()
        for pattern in said.split.test if said.split else ():
            if fnmatchcase(record.name, pattern):
                held_out.append(escape(own.name))
                matched.add(pattern)
        for pattern, kind in said.tests.items():
            if fnmatchcase(record.name, pattern):
                kinds.setdefault(escape(own.name), kind)
    splits = [each.split for each in settings.values() if each.split]
    campaign = Campaign.of(
        named,
        test_patterns=held_out if splits else None,
        kinds=kinds,
        left_out=left_out,
        strict=strict,
    )
    patterns = {pattern for split in splits for pattern in split.test} - matched
    unmatched = {p for p in patterns if not any(fnmatchcase(each.name, p) for each in left_out)}
    return replace(campaign, unmatched=tuple(sorted(unmatched)))


def read_log(path: Path, settings: CampaignFile, process: ReaderProcess) -> list[Record]:
    """Read one log into a record for each stretch without a gap.

    Args:
        path: the log.
        settings: of its folder.
        process: what reads it, where another's library does.

    Raises:
        LogError: a column is missing, holds no numbers, or the clock cannot be used.
    """
    return records_of(read_table(path, settings, process), settings.signals)


def read_table(path: Path, settings: CampaignFile, process: ReaderProcess) -> Table:
    """Read the signals of one log as they stand in it, on one clock; see `read_log`."""
    wanted = Wanted(
        settings.signals.time.column, _wanted(settings.signals), tuple(map(Path, settings.can.databases))
    )
    return table_of(read_content(path, wanted, process), settings.signals)


def read_content(path: Path, wanted: Wanted, process: ReaderProcess) -> Content:
    """Read the wanted channels of a log as they stand in it; see `read_log`."""
    known = format_of(path)
    return process.read(path, wanted) if known.libraries else known.read(path, wanted)


def records_of(table: Table, signals: SignalMap) -> list[Record]:
    """Return a record for each stretch of a log without a gap.

    Raises:
        LogError: the clock cannot be used, or no stretch is long enough.
    """
    path, column = table.source, signals.time.column
    rows = first_of_each_stamp(table.time_s, path, column=column, line_of=table.line_of)
    repeated = table.time_s.size - rows.size
    table = _rows(table, rows) if repeated else table
    time_s = table.time_s
    commands = {role: values for role, values in table.signals.items() if role in COMMAND.values()}
    parts = sections(time_s, commands, table.signals[DISPLACEMENT])
    usable = [part for part in parts if part.stop - part.start >= SHORTEST]
    if not usable:
        longest = max((part.stop - part.start for part in parts), default=time_s.size)
        raise LogError(path, f"the log has {longest} samples in a row, required at least {SHORTEST}")
    name = record_name(path)
    records = [
        _record(name if len(usable) == 1 else f"{name}@{number}", table, part)
        for number, part in enumerate(usable, start=1)
    ]
    said = list(table.notices)
    if repeated:
        said.append(f"{repeated} rows are left out: their time is that of the row before")
    left_out = time_s.size - sum(part.stop - part.start for part in usable)
    if left_out:
        said.append(f"{left_out} of {time_s.size} samples are left out: fewer than {SHORTEST} in a row")
    records[0] = replace(records[0], notices=(*records[0].notices, *said))
    return records


def _rows(table: Table, rows: np.ndarray) -> Table:
    samples = {role: values[rows] for role, values in table.signals.items()}
    return replace(table, time_s=table.time_s[rows], signals=samples)


def _record(name: str, table: Table, part: Section) -> Record:
    stamps = table.time_s[part.start : part.stop]
    samples = {role: values[part.start : part.stop] for role, values in table.signals.items()}
    if part.resampled:
        samples = resampled(samples, stamps, uniform(stamps, part.step_s))
    return Record(
        name=name,
        step_s=part.step_s,
        signals=samples,
        units=table.units,
        start_s=float(stamps[0]),
        source=table.source,
        notices=(part.notice,) if part.notice else (),
        clock=part.clock,
    )


def _wanted(signals: SignalMap) -> tuple[str, ...]:
    mapped = (
        signals.displacement,
        signals.command,
        signals.lifting_command,
        signals.lowering_command,
    )
    return tuple(dict.fromkeys(c.column for c in (*mapped, *signals.covariates) if c is not None))


def _distinct(records: Sequence[Record]) -> Sequence[Record]:
    """Put the folder's name before records that share a name."""
    names = [record.name for record in records]
    if len(set(names)) == len(names):
        return records
    return [
        replace(record, name=f"{record.source.parent.name}/{record.name}")
        if names.count(record.name) > 1 and record.source is not None
        else record
        for record in records
    ]
