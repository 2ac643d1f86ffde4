"""The one way in: `read` takes files and folders and returns a campaign."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid.campaign import Campaign
from hitchid.errors import InputError, LogError
from hitchid.grid import Section, sections
from hitchid.readers import csv, mat
from hitchid.readers.table import Table
from hitchid.record import COMMAND, DISPLACEMENT, LIFTING, LOWERING, Record, resampled
from hitchid.signals import CAMPAIGN_FILE, CampaignFile, Column, SignalMap, read_campaign_file
from hitchid.units import conversion_factor, unit_of_column

SHORTEST = 20


class Format(NamedTuple):
    """One log format.

    Attributes:
        suffixes: the endings of its files.
        read_table: reads the named columns as numbers.
        read_rows: reads all columns as text, header and rows.
    """

    suffixes: tuple[str, ...]
    read_table: Callable[[Path, Sequence[str]], Table]
    read_rows: Callable[[Path, str], tuple[list[str], list[list[str]]]]


FORMATS = (
    Format(csv.SUFFIXES, csv.read_table, csv.read_rows),
    Format(mat.SUFFIXES, mat.read_table, mat.read_rows),
)


def read(logs: str | Path | Iterable[str | Path], *, signals: str | Path | None = None) -> Campaign:
    """Read logs into a campaign.

    Args:
        logs: files and folders of any known format.
        signals: a file like `campaign.toml`; without it each folder's own is used, or the default columns
            `time_s, current_up_A, current_down_A, displacement_mm`.

    Returns:
        One record a test, a log with gaps giving several, on one clock and in one set of units.

    Raises:
        LogError: a log cannot be used.
        SettingsError: a settings file cannot be used.
        InputError: there are no logs, or they do not fit together.
    """
    paths = find_logs(logs)
    settings = settings_of(paths, signals)
    records = [record for path in paths for record in read_log(path, settings[path.parent].signals)]
    return assemble(records, settings)


def assemble(records: Sequence[Record], settings: Mapping[Path, CampaignFile]) -> Campaign:
    """Make a campaign of records and what the settings of each one's folder say of split and kinds.

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
    campaign = Campaign.of(named, test_patterns=held_out if splits else None, kinds=kinds)
    unmatched = {pattern for split in splits for pattern in split.test} - matched
    return replace(campaign, unmatched=tuple(sorted(unmatched)))


def find_logs(logs: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return every log among files and folders, sorted within each folder.

    Raises:
        InputError: a path does not exist, a file's format is not known, or a folder holds no log.
    """
    given = [logs] if isinstance(logs, str | Path) else list(logs)
    found: dict[Path, None] = {}
    for path in map(Path, given):
        if _is_folder(path):
            inside = sorted(child for child in path.iterdir() if child.is_file() and _format(child))
            if not inside:
                raise InputError(f"{path}: no log in this folder; required files ending in {_endings()}")
            found.update(dict.fromkeys(inside))
        elif path.is_file():
            format_of(path)
            found[path] = None
        else:
            raise InputError(f"{path}: there is no such file or folder")
    if not found:
        raise InputError("no logs were named; required files or folders")
    return list(found)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def format_of(path: Path) -> Format:
    """Return the format of a file, told by its ending.

    Raises:
        InputError: the ending is not known.
    """
    known = _format(path)
    if known is None:
        raise InputError(f"{path}: the format is not known; required a file ending in {_endings()}")
    return known


def settings_of(paths: Iterable[Path], signals: str | Path | None = None) -> dict[Path, CampaignFile]:
    """Return folder to settings for the folders of some logs: those given, else its own, else the default.

    Raises:
        SettingsError: a settings file cannot be used.
    """

    def of(folder: Path) -> CampaignFile:
        beside = folder / CAMPAIGN_FILE
        return read_campaign_file(beside) if beside.is_file() else CampaignFile()

    folders = dict.fromkeys(path.parent for path in paths)
    if signals is None:
        return {folder: of(folder) for folder in folders}
    return dict.fromkeys(folders, read_campaign_file(Path(signals)))


def read_log(path: Path, signals: SignalMap) -> list[Record]:
    """Read one log into a record for each stretch without a gap.

    Raises:
        LogError: a column is missing, holds no numbers, or the clock cannot be used.
    """
    table = format_of(path).read_table(path, _wanted(signals))
    for name, values in table.columns.items():
        _check_finite(table, name, values)
    time_s = table.columns[signals.time.column] * conversion_factor(signals.time.unit, "s", f"{path}: time")
    parts = sections(time_s, path, column=signals.time.column, line_of=table.line_of)
    usable = [part for part in parts if part.stop - part.start >= SHORTEST]
    if not usable:
        longest = max((part.stop - part.start for part in parts), default=time_s.size)
        raise LogError(path, f"the log has {longest} samples in a row, required at least {SHORTEST}")
    roles = _roles(table, signals)
    name = record_name(path)
    records = []
    for number, part in enumerate(usable, start=1):
        records.append(
            _record(name if len(usable) == 1 else f"{name}@{number}", path, time_s, roles, part, signals)
        )
    left_out = time_s.size - sum(part.stop - part.start for part in usable)
    if left_out:
        said = f"{left_out} of {time_s.size} samples are left out: fewer than {SHORTEST} in a row"
        records[0] = replace(records[0], notices=(*records[0].notices, said))
    return records


def record_name(path: Path) -> str:
    """Return a log's file name without its endings."""
    known = format_of(path)
    suffix = max((s for s in known.suffixes if path.name.lower().endswith(s)), key=len)
    return path.name[: -len(suffix)]


def _record(
    name: str,
    path: Path,
    time_s: np.ndarray,
    roles: dict[str, np.ndarray],
    part: Section,
    signals: SignalMap,
) -> Record:
    stamps = time_s[part.start : part.stop]
    samples = {role: values[part.start : part.stop] for role, values in roles.items()}
    if part.resampled:
        count = round(float(stamps[-1] - stamps[0]) / part.step_s) + 1
        grid = np.minimum(stamps[0] + part.step_s * np.arange(count), stamps[-1])
        samples = resampled(samples, stamps, grid)
    return Record(
        name=name,
        step_s=part.step_s,
        signals=samples,
        units=_units(signals),
        start_s=float(stamps[0]),
        source=path,
        notices=(part.notice,) if part.notice else (),
    )


def _wanted(signals: SignalMap) -> list[str]:
    mapped = (
        signals.time,
        signals.displacement,
        signals.command,
        signals.lifting_command,
        signals.lowering_command,
    )
    return list(dict.fromkeys([*(c.column for c in mapped if c is not None), *signals.covariates]))


def _roles(table: Table, signals: SignalMap) -> dict[str, np.ndarray]:
    roles = {DISPLACEMENT: table.columns[signals.displacement.column]}
    if signals.command is not None:
        signed = table.columns[signals.command.column]
        roles[COMMAND[LIFTING]] = np.maximum(signed, 0.0)
        roles[COMMAND[LOWERING]] = np.maximum(-signed, 0.0)
    for mode, column in ((LIFTING, signals.lifting_command), (LOWERING, signals.lowering_command)):
        if column is not None:
            roles[COMMAND[mode]] = table.columns[column.column]
    return {**roles, **{name: table.columns[name] for name in signals.covariates}}


def _units(signals: SignalMap) -> dict[str, str]:
    def unit(column: Column | None) -> str | None:
        return None if column is None else column.unit

    units = {
        DISPLACEMENT: signals.displacement.unit,
        COMMAND[LIFTING]: unit(signals.command or signals.lifting_command),
        COMMAND[LOWERING]: unit(signals.command or signals.lowering_command),
        **{name: unit_of_column(name) or "1" for name in signals.covariates},
    }
    return {role: unit for role, unit in units.items() if unit is not None}


def _check_finite(table: Table, name: str, values: np.ndarray) -> None:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise LogError(
            table.source,
            f"required finite numbers, came {values[bad[0]]} ({bad.size} such of {values.size} samples, "
            f"the first at sample {bad[0]})",
            line=table.line_of(int(bad[0])),
            column=name,
        )


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


def _format(path: Path) -> Format | None:
    name = path.name.lower()
    return next((known for known in FORMATS if name.endswith(known.suffixes)), None)


def _endings() -> str:
    return ", ".join(suffix for known in FORMATS for suffix in known.suffixes)
