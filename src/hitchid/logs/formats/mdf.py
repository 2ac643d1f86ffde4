"""ASAM MDF files, versions 2 to 4: groups of channels, each on the clock of its group's master."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import InputError, LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.formats.library import (
    as_log_errors,
    floats,
    import_optional,
    is_time,
    match_clocked_channels,
    to_seconds,
    unique_names,
    unit_text,
)
from hitchid.logs.formats.mdf_values import (
    holds_numbers,
    is_master,
    is_stored,
    open_mdf,
    physical_values,
    virtual_master_values,
)
from hitchid.logs.units import unit_of_column

SUFFIXES = (".mf4", ".mdf")
KIND = "an MDF file"
TIME = "time_s"  # name of the master channel of written files


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected channels of an MDF file; the time is that of each group's master."""
    asammdf = import_optional("asammdf", "mdf", path)
    notices: list[str] = []
    with as_log_errors(path, KIND), open_mdf(path, asammdf, notices) as log:
        locations = _channel_locations(log)
        masters = {group: master for group in range(len(log.groups)) if (master := _master(log, group))}
        clocked = {name for name, (group, _) in locations.items() if group in masters}
        matches = match_clocked_channels(path, list(locations), selection, clocked)
        groups = {locations[name][0] for name in matches.values()} & masters.keys()
        clocks = {group: _clock(path, log, group, masters[group]) for group in groups}
        channels = {
            requested: _channel(path, log, name, locations[name], clocks)
            for requested, name in matches.items()
        }
    return Content(path, channels, tuple(notices))


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of doubles, each under a name that may end in its unit, on the clock `time_s`."""
    # A group of channels has one master, and at least one channel on its clock.
    if TIME not in columns or len(columns) < 2:
        raise InputError(f"expected a column '{TIME}' and one more, got {', '.join(columns) or 'none'}")
    asammdf = import_optional("asammdf", "mdf", path, purpose="write")
    signals = [
        asammdf.Signal(
            samples=floats(values),
            timestamps=floats(columns[TIME]),
            name=name,
            unit=unit_of_column(name) or "",
            master_metadata=(TIME, 1),
        )
        for name, values in columns.items()
        if name != TIME
    ]
    with asammdf.MDF(version="4.10") as log, path.open("wb") as stream:
        log.append(signals, acq_name="log", comment="", common_timebase=True)
        log.save(stream)


def _channel_locations(log: Any) -> dict[str, tuple[int, int]]:
    """Return full name to group and index of each channel that holds numbers."""
    group_names = [unit_text(getattr(group.channel_group, "acq_name", None)) for group in log.groups]
    count = Counter(group_names)
    names, locations = [], []
    for number, (group, group_name) in enumerate(zip(log.groups, group_names, strict=True)):
        # A group without a unique name has its number, the only one without a name none.
        name = group_name if group_name and count[group_name] == 1 else str(number)
        prefix = "" if group_names == [None] else f"{name}/"
        for index, channel in enumerate(group.channels):
            if holds_numbers(log, number, index) and not _is_clock(log, number, index):
                names.append(f"{prefix}{channel.name}")
                locations.append((number, index))
    return dict(zip(unique_names(names), locations, strict=True))


def _master(log: Any, group: int) -> tuple[int, int] | None:
    """Return group and index of the master channel of a group, if it counts time."""
    # In version 4.2 a group may use the master of another group.
    remote_group = getattr(log.groups[group].channel_group, "cg_master_index", None)
    master_group = group if remote_group is None else remote_group
    index = log.masters_db.get(master_group)
    return (master_group, index) if index is not None and _is_clock(log, master_group, index) else None


def _is_clock(log: Any, group: int, index: int) -> bool:
    channel = log.groups[group].channels[index]
    if not is_master(log, channel):
        return False
    # Masters of version 4 may count an angle or a distance instead.
    return log.version < "4" or channel.sync_type in (0, 1)


def _clock(path: Path, log: Any, group: int, master: tuple[int, int]) -> np.ndarray:
    channel = log.groups[master[0]].channels[master[1]]
    clock = (
        physical_values(path, log, *master)
        if is_stored(log, channel)
        else virtual_master_values(path, log, *master)
    )
    _check_count(path, log, group, clock, channel.name)
    unit = unit_text(channel.unit)
    if unit is not None and not is_time(unit):
        raise LogError(path, f"is a clock with unit '{unit}', expected a unit of time", column=channel.name)
    return to_seconds(clock, unit)


def _channel(
    path: Path, log: Any, name: str, location: tuple[int, int], clocks: Mapping[int, np.ndarray]
) -> LogChannel:
    group, index = location
    values = physical_values(path, log, group, index)
    _check_count(path, log, group, values, name)
    channel = log.groups[group].channels[index]
    units = unit_text(channel.unit), unit_text(getattr(channel.conversion, "unit", None))
    # ASAM MDF 4, CCBLOCK: the conversion's unit applies only where the channel has none; MDF 3 has no other.
    unit = units[0] or units[1] if log.version >= "4" else units[1] or units[0]
    return LogChannel(values, unit, clocks.get(group))


def _check_count(path: Path, log: Any, group: int, values: np.ndarray, name: str) -> None:
    expected_count = log.groups[group].channel_group.cycles_nr
    if values.size != expected_count:
        raise LogError(path, f"is truncated: holds {values.size} of {expected_count} samples", column=name)
