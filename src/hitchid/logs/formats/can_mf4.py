"""Bus logs in MF4: the frames of a CAN bus in an MDF file."""

from collections.abc import Iterator
from dataclasses import replace
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content
from hitchid.logs.formats.can_bus import read_bus
from hitchid.logs.formats.can_streams import Frame
from hitchid.logs.formats.library import as_log_errors, import_optional
from hitchid.logs.formats.mdf_values import open_mdf

KIND = "an MDF file"
ID_BITS, EXTENDED_BIT = 0x1FFFFFFF, 0x80000000  # of the stored id: 29 bits, and the flag for them
DATA, WITHOUT_DATA = "CAN_DataFrame", ("CAN_ErrorFrame", "CAN_RemoteFrame")
# Bytes for each data length code; ISO 11898-1.
FD_LENGTHS = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64])


def is_bus_log(path: Path) -> bool:
    """Return whether an MDF file holds frames of a CAN bus.

    Args:
        path: the file.

    Raises:
        LogError: the file is damaged or was cut short, or asammdf is not installed.
    """
    asammdf = import_optional("asammdf", "mdf", path)
    with as_log_errors(path, KIND), open_mdf(path, asammdf, []) as log:
        return any(
            DATA in _channel_names(group) or f"{DATA}.ID" in _channel_names(group) for group in log.groups
        )


def read_mf4(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected signals of a CAN bus log in MF4; `read_bus` describes their names.

    Args:
        path: the log.
        selection: the requested signals, and the DBC files.

    Raises:
        LogError: the log or a DBC file is missing or unreadable, a signal is missing, or asammdf or cantools
            is not installed.
    """
    asammdf = import_optional("asammdf", "mdf", path)
    notices: list[str] = []
    content = read_bus(_read_frames(path, asammdf, notices), path, selection)
    return replace(content, notices=(*notices, *content.notices))


def _read_frames(path: Path, asammdf: Any, notices: list[str]) -> Iterator[Frame]:
    with as_log_errors(path, KIND), open_mdf(path, asammdf, notices) as log:
        frames_by_group = [_group_frames(path, log, index) for index in range(len(log.groups))]
    # One message may have frames in several groups, received and sent.
    yield from merge(*frames_by_group, key=lambda frame: frame.stamp_s)


def _channel_names(group: Any) -> set[str]:
    return {channel.name for channel in group.channels}


def _group_frames(path: Path, log: Any, index: int) -> list[Frame]:
    """Return the frames of one group of an MF4 log."""
    names, count = _channel_names(log.groups[index]), log.groups[index].channel_group.cycles_nr
    if any(name in names or f"{name}.ID" in names for name in WITHOUT_DATA):
        return [Frame(0.0, 0, 0, False, None)] * count
    if not count or f"{DATA}.ID" not in names:
        return []
    identifiers = _column(log, index, "ID").astype(np.uint32)
    data = _frame_data(log, index, names)
    stamps = log.get(f"{DATA}.ID", group=index).timestamps
    if not count == len(stamps) == len(identifiers) == len(data):
        raise LogError(path, f"is truncated: holds {min(len(identifiers), len(data))} of {count} frames")
    # Without a field of its own, the top bit of the id marks 29 bits.
    extended = _column(log, index, "IDE") if f"{DATA}.IDE" in names else identifiers & EXTENDED_BIT
    buses = _column(log, index, "BusChannel") if f"{DATA}.BusChannel" in names else np.zeros(count)
    headers = zip(
        buses.astype(int).tolist(), (identifiers & ID_BITS).tolist(), (extended != 0).tolist(), strict=True
    )
    return [
        Frame(stamp_s, *header, frame_data)
        for stamp_s, header, frame_data in zip(stamps.tolist(), headers, data, strict=True)
    ]


def _column(log: Any, index: int, name: str) -> np.ndarray:
    return log.get(f"{DATA}.{name}", group=index, raw=True).samples


def _frame_data(log: Any, index: int, names: set[str]) -> list[bytes]:
    """Return the bytes of each frame."""
    payload = np.ascontiguousarray(_column(log, index, "DataBytes"))
    if not payload.size:
        return [b""] * len(payload)
    rows = payload.view(np.uint8).reshape(len(payload), -1)
    if f"{DATA}.DataLength" in names:
        lengths = _column(log, index, "DataLength")
    else:
        lengths = FD_LENGTHS[_column(log, index, "DLC").astype(int)]
    width, all_bytes = rows.shape[1], rows.tobytes()
    ends = (width * np.arange(len(rows)) + np.minimum(lengths.astype(int), width)).tolist()
    return [all_bytes[row * width : end] for row, end in enumerate(ends)]
