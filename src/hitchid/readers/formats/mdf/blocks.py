"""Completeness of an MDF file: each block of version 4 holds its length and the links to others."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from hitchid.errors import LogError

# From ASAM MDF 4: bytes of the identification block; name, length and links of a block; offsets, bytes.
IDENTIFICATION = 64
HEADER = struct.Struct("<4s4xQQ")
VERSION_OFFSET, FLAGS_OFFSET, FINALIZED_SINCE = 28, 60, 410


NOT_FINALIZED = "the recording was never finalized: read as far as it was written"


@contextmanager
def open_mdf(path: Path, asammdf: Any, notices: list[str]) -> Iterator[Any]:
    """Open an MDF file with asammdf after a check; of one that was never finalized, a finalized copy.

    Args:
        path: the file.
        asammdf: the module.
        notices: gets a message if the file was never finalized.

    Raises:
        LogError: as `check_complete`.
    """
    is_finalized = check_complete(path)
    if not is_finalized:
        notices.append(NOT_FINALIZED)
    # The copy is in memory: asammdf's own would stay on the disk if this process is ended.
    source = path if is_finalized else BytesIO(path.read_bytes())
    with asammdf.MDF(source, process_bus_logging=False) as log:
        yield log


def check_complete(path: Path) -> bool:
    """Follow every link of a finalized MDF file of version 4; of others check the identification only.

    Many loggers never finalize: the counts and lengths that they leave out follow from the file's size.

    Args:
        path: the file.

    Returns:
        Whether the file was finalized.

    Raises:
        LogError: the file is not an MDF file, was cut short, has no block where a link points, or was never
            finalized and is older than version 4.10, which has no rules for it.
    """
    with path.open("rb") as stream:
        identification = stream.read(IDENTIFICATION)
        magic = identification[:8].rstrip(b" \0")
        if magic not in (b"MDF", b"UnFinMF"):
            raise LogError(path, "cannot be read as an MDF file: its header is not that of an MDF file")
        if len(identification) < IDENTIFICATION:
            raise LogError(path, f"is truncated: the file has {len(identification)} bytes")
        version, flags = (_read_uint16(identification, offset) for offset in (VERSION_OFFSET, FLAGS_OFFSET))
        if magic == b"UnFinMF" or flags:
            if version < FINALIZED_SINCE:
                raise LogError(path, "is truncated: its recording was never finished (unfinalized MDF)")
            return False
        if version >= 400:
            _walk(path, stream)
    return True


def _read_uint16(block: bytes, offset: int) -> int:
    return int.from_bytes(block[offset : offset + 2], "little")


def _walk(path: Path, stream: BinaryIO) -> None:
    size = stream.seek(0, 2)
    seen, pending = {0, IDENTIFICATION}, [IDENTIFICATION]
    while pending:
        links = _links(path, stream, pending.pop(), size)
        pending += [link for link in dict.fromkeys(links) if link not in seen]
        seen.update(links)


def _links(path: Path, stream: BinaryIO, address: int, size: int) -> tuple[int, ...]:
    if address + HEADER.size > size:
        raise LogError(path, f"is truncated: a block starts at byte {address}, the file has {size}")
    stream.seek(address)
    name, length, links = HEADER.unpack(stream.read(HEADER.size))
    if not name.startswith(b"##") or length < HEADER.size + 8 * links:
        raise LogError(path, f"cannot be read as an MDF file: there is no block at byte {address}")
    if address + length > size:
        raise LogError(path, f"is truncated: a block ends at byte {address + length}, the file has {size}")
    return struct.unpack(f"<{links}Q", stream.read(8 * links))
