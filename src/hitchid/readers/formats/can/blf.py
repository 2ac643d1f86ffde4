"""Completeness of a BLF log: python-can reads a truncated log without an error."""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from hitchid.errors import LogError

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


class Inventory(NamedTuple):
    """Content of a BLF log.

    Attributes:
        frame_count: number of frames, error frames included.
        closed: whether the recording was closed; only then can a missing end be detected.
    """

    frame_count: int
    closed: bool


def inventory(path: Path) -> Inventory:
    """Count the frames of a BLF log and check its structure.

    Args:
        path: the log.

    Raises:
        LogError: the file is not a BLF log, was cut short, or has no object where one is expected.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        start = stream.read(HEADER.size)
        if len(start) < HEADER.size or not start.startswith(b"LOGG"):
            raise LogError(path, "cannot be read as a CAN log: it does not start as a BLF file")
        _, header, stated_size = HEADER.unpack(start)
        if size < max(header, stated_size):
            raise LogError(path, f"is truncated: holds {size} of {max(header, stated_size)} bytes")
        stream.seek(header)
        frame_count = _count_frames(path, stream)
    return Inventory(frame_count, closed=size - stated_size < PADDING)


def _count_frames(path: Path, stream: BinaryIO) -> int:
    count, rest = 0, b""
    for kind, content in _iterate_objects(path, stream):
        count += kind in FRAME_KINDS
        if kind == CONTAINER_KIND:
            container_count, rest = _count_container_frames(path, rest + _unpack(path, content))
            count += container_count
    if rest.strip(b"\0"):
        raise LogError(path, "is truncated: it ends within a frame")
    return count


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
