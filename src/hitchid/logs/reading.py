"""`read`: from files and folders of logs to a campaign."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from glob import escape
from pathlib import Path
from typing import Any

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.logs.campaign import Campaign
from hitchid.logs.content import ChannelSelection, Content
from hitchid.logs.dataframes import Frame
from hitchid.logs.formats import format_of, known_format, known_suffixes, record_name
from hitchid.logs.log_table import LogTable, records_of, table_of
from hitchid.logs.reader_process import ReaderProcess
from hitchid.logs.record import DISPLACEMENT, Record
from hitchid.logs.signal_map import CAMPAIGN_FILE, CampaignFile, read_campaign_file
from hitchid.logs.unification import LeftOut, refuse, split_usable
from hitchid.logs.units import conversion_factor

# Find logs in folders, and their settings.

DATABASE_SUFFIX = ".dbc"


def find_logs(logs: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return every log among files and folders, sorted within each folder.

    Named files are returned whatever their format, if at least one format is known. Links to logs and to
    folders are followed.

    Raises:
        InputError: a path does not exist, a link to a log is broken, no file's format is known, or a folder
            holds no log.
    """
    inputs = [logs] if isinstance(logs, str | Path) else list(logs)
    paths: dict[Path, None] = {}
    for path in map(Path, inputs):
        try:
            is_folder = path.is_dir()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        if is_folder:
            folder_logs = [file for file in sorted(path.iterdir()) if known_format(file) and _is_file(file)]
            if not folder_logs:
                raise InputError(
                    f"{path}: no log in this folder; expected files ending in {known_suffixes()}"
                )
            paths.update(dict.fromkeys(folder_logs))
        elif _is_file(path):
            paths[path] = None
        else:
            raise InputError(f"{path}: there is no such file or folder")
    if not paths:
        raise InputError("no logs given; expected files or folders")
    # Beside logs a note is left out with its reason; alone it is an error that lists the formats.
    if not any(map(known_format, paths)):
        format_of(next(iter(paths)))
    return list(paths)


def settings_of(paths: Iterable[Path], signals: str | Path | None = None) -> dict[Path, CampaignFile]:
    """Return folder to settings for the folders of logs: `signals`, else the folder's own, else the default.

    CAN databases are those named in the settings, relative to that file, else all in the folder of the logs.

    Raises:
        InputError: a folder's settings or databases are a broken link.
        SettingsError: a settings file cannot be used.
    """
    # A file that is named counts for all folders, also those with a campaign.toml of their own.
    shared = None
    if signals is not None:
        shared = _with_databases(read_campaign_file(Path(signals)), Path(signals).parent)

    def for_folder(folder: Path) -> CampaignFile:
        settings_path = folder / CAMPAIGN_FILE
        settings = shared or CampaignFile()
        if shared is None and _is_file(settings_path):
            settings = _with_databases(read_campaign_file(settings_path), folder)
        if settings.can.databases or not folder.is_dir():
            return settings
        files = [child for child in sorted(folder.iterdir()) if child.suffix.lower() == DATABASE_SUFFIX]
        return _with_databases(settings, folder, tuple(file.name for file in files if _is_file(file)))

    return {folder: for_folder(folder) for folder in dict.fromkeys(path.parent for path in paths)}


def _is_file(path: Path) -> bool:
    """Return whether a path is a file or a link to one; raises InputError for a broken link."""
    if path.is_symlink() and not path.exists():
        raise InputError(
            f"{path}: is a broken link to {os.readlink(path)}; expected a link to an existing file"
        )
    return path.is_file()


def _with_databases(
    settings: CampaignFile, folder: Path, names: tuple[str, ...] | None = None
) -> CampaignFile:
    """Return the settings with the paths of their databases, or of those with other names in a folder."""
    names = settings.can.databases if names is None else names
    can = settings.can.model_copy(update={"databases": tuple(str(folder / name) for name in names)})
    return settings.model_copy(update={"can": can})


LOGS = "files and folders of logs, DataFrames, or records"
SIGNALS = "a mapping for DataFrames, as [signals] in campaign.toml"
KINDS = (str, Path, Frame, Record)


@checks.named_arguments
def read(
    logs: str | Path | Frame | Record | Mapping[str, Frame] | Iterable[str | Path | Frame | Record],
    *,
    signals: str | Path | Mapping[str, object] | None = None,
    strict: bool = False,
) -> Campaign:
    """Read logs into a campaign; unusable logs are left out and listed in `Campaign.left_out`.

    Args:
        logs: files and folders of any known format; or what is in memory: a DataFrame, several by name or
            in a list, or records.
        signals: a file like `campaign.toml`; without it each folder's own is used, or the default columns
            `time_s, current_up_A, current_down_A, displacement_mm`. For DataFrames the content of
            `[signals]`, see `Campaign.from_dataframes`.
        strict: raise an error for an unusable log.

    Returns:
        One record a test, several for a log with gaps; all with one sampling time and one set of units.

    Raises:
        LogError: no log can be used.
        SettingsError: a settings file cannot be used.
        InputError: there are no logs, or no log of a direction can be used.
    """
    # So that every function that takes logs takes a campaign, too.
    if isinstance(logs, Campaign):
        return logs
    if isinstance(logs, Mapping | Frame | Record):
        return _in_memory([logs] if isinstance(logs, Frame | Record) else logs, signals, strict=strict)
    inputs = (logs,) if isinstance(logs, str | Path) else checks.tuple_of(logs, KINDS, "logs", LOGS)
    if any(not isinstance(item, str | Path) for item in inputs):
        return _in_memory(inputs, signals, strict=strict)
    paths = find_logs([item for item in inputs if isinstance(item, str | Path)])
    settings = settings_of(paths, None if signals is None else checks.path(signals, "signals"))
    records, left_out = read_logs(paths, settings, strict=strict)
    if not records:
        refuse(left_out, "logs")
    return assemble(records, settings, left_out, strict=strict)


def _in_memory(tables: Mapping[Any, Any] | Sequence[object], signals: object, *, strict: bool) -> Campaign:
    """Return the campaign of tables or records; those of one call are of one kind."""
    if not isinstance(tables, Mapping) and any(isinstance(table, Record) for table in tables):
        return Campaign.of(checks.tuple_of(tables, Record, "logs", LOGS), strict=strict)
    signal_map = None if signals is None else checks.instance(signals, Mapping, "signals", SIGNALS)
    return Campaign.from_dataframes(tables, signals=signal_map, strict=strict)


def read_logs(
    paths: Sequence[Path], settings: Mapping[Path, CampaignFile], *, strict: bool = False
) -> tuple[list[Record], list[LeftOut]]:
    """Read logs one by one; return their records and the unreadable logs.

    Raises:
        LogError: with `strict`, a log cannot be read.
    """
    # A file of no known format has no ending to remove; it is left out under its whole name.
    names = [record_name(path) if known_format(path) else path.name for path in paths]
    with ReaderProcess() as process:
        records_by_log, left_out = split_usable(
            zip(names, paths, strict=True),
            lambda path: read_log(path, settings[path.parent], process),
            strict=strict,
        )
    return [record for records in records_by_log for record in records], left_out


def assemble(
    records: Sequence[Record],
    settings: Mapping[Path, CampaignFile],
    left_out: Sequence[LeftOut] = (),
    *,
    strict: bool = False,
) -> Campaign:
    """Make a campaign of records, with the split and the kinds from the settings of each folder.

    A pattern may match a log that could not be read.

    Raises:
        InputError, LogError: as `Campaign.of`.
    """
    distinct_records = _with_distinct_names(records)
    # A pattern counts in its own folder alone: from here on it stands for the tests that it matched there.
    held_out, kinds, matched = [], {}, set()
    for record, distinct_record in zip(records, distinct_records, strict=True):
        folder_settings = settings[record.source.parent] if record.source is not None else CampaignFile()
        for pattern in folder_settings.split.test if folder_settings.split else ():
            if fnmatchcase(record.name, pattern):
                held_out.append(escape(distinct_record.name))
                matched.add(pattern)
        for pattern, kind in folder_settings.tests.items():
            if fnmatchcase(record.name, pattern):
                kinds.setdefault(escape(distinct_record.name), kind)
    splits = [settings_file.split for settings_file in settings.values() if settings_file.split]
    campaign = Campaign.of(
        distinct_records,
        test_patterns=held_out if splits else None,
        kinds=kinds,
        left_out=left_out,
        strict=strict,
    )
    end_stops = _end_stops(distinct_records, settings, campaign)
    patterns = {pattern for split in splits for pattern in split.test} - matched
    # A log that cannot be read is known by name: a pattern for it is no misspelling.
    unmatched = {p for p in patterns if not any(fnmatchcase(log.name, p) for log in left_out)}
    return replace(campaign, unmatched=tuple(sorted(unmatched)), end_stops=end_stops)


def _end_stops(
    records: Sequence[Record], settings: Mapping[Path, CampaignFile], campaign: Campaign
) -> tuple[float, float] | None:
    """Return the end stops that the settings of the folders give, in the unit of the campaign."""
    unit, stops = campaign.units[DISPLACEMENT], {}
    for record in records:
        given = settings[record.source.parent].end_stops if record.source is not None else None
        if given is not None:
            # Folders may measure in unlike units; twelve digits hide the rounding of the conversion.
            factor = conversion_factor(record.unit, unit, f"end_stops of '{record.name}'")
            low, high = (float(f"{factor * position:.12g}") for position in given)
            stops[low, high] = record.name
    if len(stops) > 1:
        texts = [f"[{low:g}, {high:g}] of '{name}'" for (low, high), name in stops.items()]
        raise InputError(f"end_stops: expected the same in all folders, got {' and '.join(texts)} in {unit}")
    return next(iter(stops), None)


def read_log(path: Path, settings: CampaignFile, process: ReaderProcess) -> list[Record]:
    """Read one log, by the settings of its folder, into a record for each stretch without a gap.

    Raises:
        LogError: a column is missing, holds no numbers, or the clock cannot be used.
    """
    return records_of(record_name(path), read_table(path, settings, process), settings.signals)


def read_table(path: Path, settings: CampaignFile, process: ReaderProcess) -> LogTable:
    """Read the signals of one log without cutting or resampling it at gaps; see `read_log`."""
    signals, databases = settings.signals, tuple(map(Path, settings.can.databases))
    selection = ChannelSelection(signals.time.column, signals.measured, databases)
    return table_of(read_content(path, selection, process), signals)


def read_content(path: Path, selection: ChannelSelection, process: ReaderProcess) -> Content:
    """Read the selected channels of a log as stored; see `read_log`."""
    log_format = format_of(path)
    # A library may crash on a damaged file: it runs in another process. Text is read here, which is faster.
    return process.read(path, selection) if log_format.libraries else log_format.read(path, selection)


def _with_distinct_names(records: Sequence[Record]) -> Sequence[Record]:
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
