"""CAN logs, decoded by DBC files: of Vector (`.asc`, `.blf`), PEAK (`.trc`), candump, MF4 with bus frames."""

import gzip
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content
from hitchid.logs.formats.can_bus import read_bus as read_bus
from hitchid.logs.formats.can_decoder import Frame, candump_frames, count_frames
from hitchid.logs.formats.can_decoder import is_candump as is_candump
from hitchid.logs.formats.library import as_log_errors, import_optional
from hitchid.logs.formats.mdf_values import open_mdf

SUFFIXES = (".asc", ".asc.gz", ".blf", ".trc")
CANDUMP_SUFFIXES = (".log",)
KIND, MF4_KIND = "a CAN log", "an MDF file"
ID_BITS, EXTENDED_BIT = 0x1FFFFFFF, 0x80000000  # of the stored id: 29 bits, and the flag for them
DATA, WITHOUT_DATA = "CAN_DataFrame", ("CAN_ErrorFrame", "CAN_RemoteFrame")
# Bytes for each data length code; ISO 11898-1.
FD_LENGTHS = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64])


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected signals of a CAN log; `read_bus` describes their names."""
    notices: list[str] = []
    readers = {".blf": _read_blf, ".log": _read_candump, ".mf4": _read_mf4, ".mdf": _read_mf4}
    content = read_bus(readers.get(path.suffix.lower(), _read_text)(path, notices), path, selection)
    return replace(content, notices=(*notices, *content.notices))


@dataclass
class _AscText:
    """State while an ASC log is read: line number, block markers seen, notices."""

    line: int = 0
    begun: bool = False
    ended: bool = False
    notices: list[str] = field(default_factory=list)

    def lines(self, text: Iterable[str]) -> Iterator[str]:
        """Yield the lines for python-can."""
        before_frames = True
        for self.line, line in enumerate(text, start=1):
            words = line.split(None, 4)
            if not words:
                continue
            is_event = words[0][0].isdigit()
            if is_event and not line.endswith("\n"):
                # A cut frame may look complete: the last digit of a byte may be missing.
                self.notices.append("the last line is left out: it is incomplete")
                return
            if is_event and before_frames:
                # python-can drops the first line after the header.
                yield "\n"
            before_frames &= not is_event
            self.begun |= line.lower().lstrip().startswith("begin triggerblock")
            self.ended |= line.lower().lstrip().startswith("end triggerblock")
            # A send request is not a frame on the bus; the frame follows as Tx.
            if not (is_event and "TxRq" in words):
                yield line


def _read_text(path: Path, notices: list[str]) -> Iterator[Frame]:
    library = import_optional("can", "can", path)
    text, is_asc = _AscText(notices=notices), path.suffix.lower() != ".trc"
    try:
        # Latin-1 decodes any byte; names and comments, which may hold others, are not used.
        open_text = gzip.open if path.name.lower().endswith(".gz") else open
        with open_text(path, "rt", encoding="latin-1") as stream:
            reader = (library.ASCReader if is_asc else library.TRCReader)(text.lines(stream))
            for message in reader:
                if is_asc and reader.timestamps_format == "relative":
                    raise LogError(
                        path,
                        "its time stamps are relative to the previous line; expected 'base hex timestamps "
                        "absolute'",
                    )
                # python-can and PEAK count buses from 1.
                frame = _to_frame(message)
                yield frame if is_asc else frame._replace(bus=message.channel or 0)
    except (LogError, MemoryError):
        raise
    except Exception as error:  # python-can may raise anything on a damaged line
        detail = str(error) or type(error).__name__
        raise LogError(path, f"cannot be read as {KIND}: {detail}", line=text.line or None) from error
    if text.begun and not text.ended:
        notices.append("the log has no 'End TriggerBlock': it may be incomplete")


def _read_candump(path: Path, notices: list[str]) -> Iterator[Frame]:
    with as_log_errors(path, KIND), path.open(encoding="latin-1") as stream:
        yield from candump_frames(stream, notices)


def _read_blf(path: Path, notices: list[str]) -> Iterator[Frame]:
    library = import_optional("can", "can", path)
    with as_log_errors(path, KIND):
        expected_count, is_closed = count_frames(path)
        if not is_closed:
            notices.append("the log was never closed: it may be incomplete")
        frame_count = 0
        with library.BLFReader(path) as reader:
            # From 1970, the stamps would be rounded to 0.25 µs.
            reader.start_timestamp = 0.0
            for message in reader:
                frame_count += 1
                yield _to_frame(message)
        if frame_count != expected_count:
            problem = f"{frame_count} of its {expected_count} frames can be read"
            raise LogError(path, f"cannot be read as {KIND}: {problem}")


def _to_frame(message: Any) -> Frame:
    data: bytes | None = None
    if not (message.is_error_frame or message.is_remote_frame):
        data = bytes(message.data)
        if len(data) < min(message.dlc, 64 if message.is_fd else 8):
            data = b""
    # python-can counts buses from 0, both formats from 1.
    bus = message.channel + 1 if isinstance(message.channel, int) else 0
    return Frame(message.timestamp, bus, message.arbitration_id, message.is_extended_id, data)


# Bus logs in MF4: the frames of a CAN bus in an MDF file.


def is_bus_log(path: Path) -> bool:
    """Return whether an MDF file holds frames of a CAN bus."""
    asammdf = import_optional("asammdf", "mdf", path)
    with as_log_errors(path, MF4_KIND), open_mdf(path, asammdf, []) as log:
        return any(
            DATA in _channel_names(group) or f"{DATA}.ID" in _channel_names(group) for group in log.groups
        )


def _read_mf4(path: Path, notices: list[str]) -> Iterator[Frame]:
    asammdf = import_optional("asammdf", "mdf", path)
    with as_log_errors(path, MF4_KIND), open_mdf(path, asammdf, notices) as log:
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
