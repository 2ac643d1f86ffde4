"""MDF files of ASAM, versions 2 to 4: groups of channels, each on the clock of its group's master."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.data.units import unit_of_column
from hitchid.errors import LogError
from hitchid.readers.content import Channel, Content, Wanted
from hitchid.readers.formats.cf import in_seconds, is_time
from hitchid.readers.formats.extra import damage, floats, needed, numbered, picked, spelled
from hitchid.readers.formats.mdf.blocks import check_whole
from hitchid.readers.formats.mdf.numbers import counted, holds_numbers, is_master, is_stored, physical

SUFFIXES = (".mf4", ".mdf")
KIND = "an MDF file"
TIME = "time_s"


def read(path: Path, wanted: Wanted) -> Content:
    """Read the wanted channels of an MDF file.

    Args:
        path: the file.
        wanted: what is asked for; the time is that of each group's master.

    Raises:
        LogError: the file is damaged or was cut short, a channel is missing, or asammdf is.
    """
    asammdf = needed("asammdf", "mdf", path)
    with damage(path, KIND):
        check_whole(path)
        with asammdf.MDF(path, process_bus_logging=False) as log:
            places = _places(log)
            masters = {group: master for group in range(len(log.groups)) if (master := _master(log, group))}
            clocked = {name for name, (group, _) in places.items() if group in masters}
            found = picked(path, list(places), wanted, clocked)
            groups = {places[name][0] for name in found.values()} & masters.keys()
            clocks = {group: _clock(path, log, group, masters[group]) for group in groups}
            channels = {
                asked: _channel(path, log, name, places[name], clocks) for asked, name in found.items()
            }
    return Content(path, channels)


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of doubles as one group on the clock `time_s`, in version 4.10.

    Args:
        path: the file; one that is there is replaced.
        columns: each under a name that may end in its unit; `time_s` and at least one more.

    Raises:
        LogError: asammdf is missing.
        ValueError: there is no column `time_s`, or none beside it.
    """
    if TIME not in columns or len(columns) < 2:
        raise ValueError(f"required a column '{TIME}' and one more, got {', '.join(columns) or 'none'}")
    asammdf = needed("asammdf", "mdf", path, purpose="write")
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


def _places(log: Any) -> dict[str, tuple[int, int]]:
    """Return the full name of each channel that holds numbers, to its group and its place in there."""
    titles = _titles(log)
    names, places = [], []
    for number, group in enumerate(log.groups):
        for index, channel in enumerate(group.channels):
            if holds_numbers(log, number, index) and not _is_clock(log, number, index):
                names.append(f"{titles[number]}/{channel.name}" if titles[number] else channel.name)
                places.append((number, index))
    return dict(zip(numbered(names), places, strict=True))


def _titles(log: Any) -> list[str]:
    """Return what each group is called: its number where it has no name or shares it."""
    names = [spelled(getattr(group.channel_group, "acq_name", None)) for group in log.groups]
    if names == [None]:
        return [""]
    count = Counter(names)
    return [name if name and count[name] == 1 else str(number) for number, name in enumerate(names)]


def _master(log: Any, group: int) -> tuple[int, int] | None:
    """Return group and place of the channel that is this group's clock, if it has one that counts time."""
    # In version 4.2 a group may be on the master of another one.
    remote = getattr(log.groups[group].channel_group, "cg_master_index", None)
    holder = group if remote is None else remote
    index = log.masters_db.get(holder)
    return (holder, index) if index is not None and _is_clock(log, holder, index) else None


def _is_clock(log: Any, group: int, index: int) -> bool:
    channel = log.groups[group].channels[index]
    if not is_master(log, channel):
        return False
    # Masters of version 4 may count an angle or a distance instead.
    return log.version < "4" or channel.sync_type in (0, 1)


def _clock(path: Path, log: Any, group: int, master: tuple[int, int]) -> np.ndarray:
    channel = log.groups[master[0]].channels[master[1]]
    clock = physical(path, log, *master) if is_stored(log, channel) else counted(path, log, *master)
    _check_count(path, log, group, clock, channel.name)
    unit = spelled(channel.unit)
    if unit is not None and not is_time(unit):
        raise LogError(path, f"is a clock in '{unit}', required a unit of time", column=channel.name)
    return in_seconds(clock, unit)


def _channel(
    path: Path, log: Any, name: str, place: tuple[int, int], clocks: Mapping[int, np.ndarray]
) -> Channel:
    group, index = place
    values = physical(path, log, group, index)
    _check_count(path, log, group, values, name)
    channel = log.groups[group].channels[index]
    units = spelled(channel.unit), spelled(getattr(channel.conversion, "unit", None))
    # ASAM MDF 4, CCBLOCK: the conversion's unit applies only where the channel has none; MDF 3 has no other.
    unit = units[0] or units[1] if log.version >= "4" else units[1] or units[0]
    return Channel(values, unit, clocks.get(group))


def _check_count(path: Path, log: Any, group: int, values: np.ndarray, name: str) -> None:
    promised = log.groups[group].channel_group.cycles_nr
    if values.size != promised:
        raise LogError(path, f"was cut short: holds {values.size} of {promised} samples", column=name)
