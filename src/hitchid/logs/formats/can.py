"""CAN logs, decoded by DBC files: of Vector (`.asc`, `.blf`), PEAK (`.trc`), candump, MF4 with bus frames."""

import gzip
import re
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from heapq import merge
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content
from hitchid.logs.formats.can_bus import read_bus as read_bus
from hitchid.logs.formats.can_decoder import Frame
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


def _read_blf(path: Path, notices: list[str]) -> Iterator[Frame]:
    library = import_optional("can", "can", path)
    with as_log_errors(path, KIND):
        expected_count, is_closed = _count_frames(path)
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


# Logs of candump, of the SocketCAN utilities: its log file and what it prints with absolute times.

LONGEST_LINE = 400  # characters; printed with their text, 64 bytes take 310
HEAD_LINES = 20  # lines among which a log has its first frame (chosen)
ERROR_FRAME = 0x20000000  # flag in the id; linux/can.h
LINE = re.compile(
    r"\s*\((?P<stamp>\d+\.\d+)\)\s+(?P<bus>\S+)\s+(?:[RT]X\b.*?\s)?(?P<id>[0-9A-Fa-f]{3,8})"
    r"(?:#(?:#[0-9A-Fa-f])?(?:R\d?|(?P<packed>(?:[0-9A-Fa-f]{2}\.?)*))(?:\s+[RT])?"
    r"|\s+\[\d+\]\s+(?:remote request|(?P<spaced>[0-9A-Fa-f]{2}(?:\s+[0-9A-Fa-f]{2})*)?(?:\s+'.*')?))\s*"
)


def is_candump(path: Path) -> bool:
    """Return whether one of the first lines of a file is a frame as candump writes it."""
    with path.open(encoding="latin-1") as stream:
        return any(
            LINE.fullmatch(line)
            for line in islice(iter(lambda: stream.readline(LONGEST_LINE), ""), HEAD_LINES)
        )


def _read_candump(path: Path, notices: list[str]) -> Iterator[Frame]:
    others: list[int] = []
    with as_log_errors(path, KIND), path.open(encoding="latin-1") as stream:
        for number, line in enumerate(stream, start=1):
            match = LINE.fullmatch(line)
            # A cut frame may look complete: its last bytes may be missing.
            if match is None or not line.endswith("\n"):
                others += [number] if line.strip() else []
                continue
            identifier, bus = int(match["id"], 16), re.search(r"\d+$", match["bus"])
            text = match["packed"] if match["packed"] is not None else match["spaced"]
            is_data = text is not None and not identifier & ERROR_FRAME
            data = bytes.fromhex((text or "").replace(".", "")) if is_data else None
            # candump writes 11 bits as three digits and 29 as eight.
            is_extended = len(match["id"]) > 3
            yield Frame(float(match["stamp"]), int(bus[0]) if bus else 0, identifier, is_extended, data)
    if others:
        notices.append(
            f"left out: {len(others)} lines that are no complete frames, the first is line {others[0]}"
        )


# Completeness of a BLF log: python-can reads a truncated log without an error.

# Signature, size of the header, size of the file.
HEADER = struct.Struct("<4sL8xQ")
# Signature, sizes of the header and of the object, kind.
OBJECT = struct.Struct("<4s4xLL")
# Compression method, uncompressed length.
CONTAINER = struct.Struct("<H6xL4x")
OBJECT_SIGNATURE = b"LOBJ"
PADDING = 4  # bytes; objects begin at multiples of it
CONTAINER_KIND, UNCOMPRESSED, DEFLATED = 10, 0, 2  # kind of object; compression methods
# Kinds of objects that python-can returns: frames, two of CAN FD, errors.
FRAME_KINDS = frozenset((1, 86, 100, 101, 73))


def _count_frames(path: Path) -> tuple[int, bool]:
    """Return the number of frames of a BLF log, error frames included, and whether it was closed.

    Of a log that was not, no missing end is seen.

    Raises:
        LogError: the log is damaged or cut.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        start = stream.read(HEADER.size)
        if len(start) < HEADER.size or not start.startswith(b"LOGG"):
            raise LogError(path, "cannot be read as a CAN log: it does not start as a BLF file")
        _, header, stated_size = HEADER.unpack(start)
        # The stated size is the only sign of a cut between two objects.
        if size < max(header, stated_size):
            raise LogError(path, f"is truncated: holds {size} of {max(header, stated_size)} bytes")
        stream.seek(header)
        count, rest = 0, b""
        for kind, content in _iterate_objects(path, stream):
            count += kind in FRAME_KINDS
            if kind == CONTAINER_KIND:
                container_count, rest = _count_container_frames(path, rest + _unpack(path, content))
                count += container_count
        if rest.strip(b"\0"):
            raise LogError(path, "is truncated: it ends within a frame")
    return count, size - stated_size < PADDING


def _iterate_objects(path: Path, stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of each top-level object."""
    while start := stream.read(OBJECT.size):
        if len(start) < OBJECT.size:
            raise LogError(path, "is truncated: it ends within the start of an object")
        signature, length, kind = OBJECT.unpack(start)
        if signature != OBJECT_SIGNATURE or length < OBJECT.size:
            position = stream.tell() - OBJECT.size
            raise LogError(path, f"cannot be read as a CAN log: there is no object at byte {position}")
        content = stream.read(length - OBJECT.size)
        if len(content) < length - OBJECT.size:
            raise LogError(path, "is truncated: it ends within an object")
        stream.read(length % PADDING)
        yield kind, content


def _unpack(path: Path, content: bytes) -> bytes:
    if len(content) < CONTAINER.size:
        raise LogError(path, "cannot be read as a CAN log: a container is shorter than its header")
    method, length = CONTAINER.unpack_from(content)
    packed = content[CONTAINER.size :]
    if method not in (UNCOMPRESSED, DEFLATED):
        raise LogError(path, f"cannot be read as a CAN log: its compression, number {method}, is not known")
    try:
        # A damaged file must not unpack to more than the stated length.
        unpacked = zlib.decompressobj().decompress(packed, length + 1) if method == DEFLATED else packed
    except zlib.error as error:
        raise LogError(path, f"cannot be read as a CAN log: {error}") from error
    if len(unpacked) != length:
        raise LogError(
            path, f"cannot be read as a CAN log: a container holds {len(unpacked)} bytes, expected {length}"
        )
    return unpacked


def _count_container_frames(path: Path, data: bytes) -> tuple[int, bytes]:
    """Return the number of frames in a container, and the beginning of a frame that the next continues."""
    count, position = 0, 0
    while True:
        start = data.find(OBJECT_SIGNATURE, position, position + 2 * PADDING)
        if start < 0 and len(data) - position >= 2 * PADDING:
            raise LogError(path, "cannot be read as a CAN log: an expected object is missing")
        if start < 0 or start + OBJECT.size > len(data):
            return count, data[position:]
        _, length, kind = OBJECT.unpack_from(data, start)
        if length < OBJECT.size:
            raise LogError(path, "cannot be read as a CAN log: an object is shorter than its header")
        if start + length > len(data):
            return count, data[start:]
        count += kind in FRAME_KINDS
        position = start + length


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
