"""From the raw samples of an MDF channel to physical numbers, in doubles throughout."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.formats.library import floats

# Completeness of an MDF file: each block of version 4 holds its length and the links to others.

# From ASAM MDF 4: bytes of the identification block; name, length and links of a block; offsets, bytes.
IDENTIFICATION = 64
HEADER = struct.Struct("<4s4xQQ")
VERSION_OFFSET, FLAGS_OFFSET, FINALIZED_SINCE = 28, 60, 410


NOT_FINALIZED = "the recording was never finalized: read as far as it was written"


@contextmanager
def open_mdf(path: Path, asammdf: Any, notices: list[str]) -> Iterator[Any]:
    """Open an MDF file with asammdf after a check; of one that was never finalized, a copy, with a notice."""
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
    Returned is whether the file was finalized.
    """
    with path.open("rb") as stream:
        identification = stream.read(IDENTIFICATION)
        magic = identification[:8].rstrip(b" \0")
        if magic not in (b"MDF", b"UnFinMF"):
            raise LogError(path, "cannot be read as an MDF file: its header is not that of an MDF file")
        if len(identification) < IDENTIFICATION:
            raise LogError(path, f"is truncated: the file has {len(identification)} bytes")
        version, flags = (
            int.from_bytes(identification[offset : offset + 2], "little")
            for offset in (VERSION_OFFSET, FLAGS_OFFSET)
        )
        if magic == b"UnFinMF" or flags:
            if version < FINALIZED_SINCE:
                raise LogError(path, "is truncated: its recording was never finished (unfinalized MDF)")
            return False
        size = stream.seek(0, 2)
        # A link of zero leads nowhere; blocks may refer to each other in circles.
        seen, pending = {0, IDENTIFICATION}, [IDENTIFICATION] if version >= 400 else []
        while pending:
            links = _links(path, stream, pending.pop(), size)
            pending += [link for link in dict.fromkeys(links) if link not in seen]
            seen.update(links)
    return True


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


class _Codes(NamedTuple):
    """Codes in the blocks of one generation of MDF files."""

    types: frozenset[int]  # data types: integers and real numbers
    masters: frozenset[int]
    channels: frozenset[int]  # channel types with one value of fixed size a record, masters included
    texts: frozenset[int]  # conversions to text
    formulas: frozenset[int]  # conversions by a formula


# Codes of ASAM MDF 3 and 4.
VIRTUAL = 3  # channel type of a master without stored samples, version 4
MDF3_CODES = _Codes(
    types=frozenset({0, 1, 2, 3, *range(9, 17)}),
    masters=frozenset({1}),
    channels=frozenset({0, 1}),
    texts=frozenset({11, 12}),
    formulas=frozenset({10}),
)
MDF4_CODES = _Codes(
    types=frozenset(range(6)),
    masters=frozenset({2, 3}),
    channels=frozenset({0, 2, 3, 6}),
    texts=frozenset({7, 8, 11}),
    formulas=frozenset({3}),
)


def is_master(log: Any, channel: Any) -> bool:
    """Return whether a channel is the master of its group."""
    return channel.channel_type in _codes(log).masters


def is_stored(log: Any, channel: Any) -> bool:
    """Return whether a master's samples are stored; else they are computed from their index."""
    return channel.channel_type != VIRTUAL if log.version >= "4" else channel.bit_count > 0


def holds_numbers(log: Any, group: int, index: int) -> bool:
    """Return whether a channel holds more than one real number."""
    codes, data_group = _codes(log), log.groups[group]
    channel = data_group.channels[index]
    is_scalar = not (data_group.channel_dependencies and data_group.channel_dependencies[index])
    is_supported = channel.data_type in codes.types and channel.channel_type in codes.channels
    return is_scalar and is_supported and data_group.channel_group.cycles_nr > 1


def physical_values(path: Path, log: Any, group: int, index: int) -> np.ndarray:
    """Return the samples of a channel converted to physical numbers; NaN where they are marked invalid."""
    channel = log.groups[group].channels[index]
    # With this option asammdf returns the invalidation bits; without it, it removes invalid samples.
    raw, invalid = log.get(
        group=group, index=index, raw=True, samples_only=True, ignore_invalidation_bits=True
    )
    # asammdf would scale single-precision samples in single precision.
    values = _convert(path, log, channel, floats(raw))
    if invalid is not None:
        values[np.asarray(invalid, dtype=bool)] = np.nan
    return values


def virtual_master_values(path: Path, log: Any, group: int, index: int) -> np.ndarray:
    """Return the samples of a master, computed from their index."""
    data_group = log.groups[group]
    channel = data_group.channels[index]
    numbers = np.arange(data_group.channel_group.cycles_nr, dtype=np.float64)
    if log.version >= "4":
        return _convert(path, log, channel, numbers)
    return numbers * (channel.sampling_rate or 1.0)


def _convert(path: Path, log: Any, channel: Any, values: np.ndarray) -> np.ndarray:
    codes, conversion = _codes(log), channel.conversion
    if conversion is None or not values.size:
        return values
    blocks = [conversion, *_scales(conversion)]
    # asammdf may evaluate a formula as Python: a file must not execute code.
    if any(block.conversion_type in codes.formulas for block in blocks):
        problem = "is converted by a formula, which is not supported; choose another channel"
        raise LogError(path, problem, column=channel.name)
    if conversion.conversion_type in codes.texts and len(blocks) == 1:
        return values  # numbers of states, whose names are text
    converted = np.asarray(conversion.convert(values))
    if converted.dtype.kind in "fiub":
        return floats(converted)
    # Text for some numbers, such as 'sensor fault' for the largest, and a scale for the others.
    return np.array([value if isinstance(value, int | float) else np.nan for value in converted.tolist()])


def _scales(conversion: Any) -> list[Any]:
    blocks = (getattr(conversion, "referenced_blocks", None) or {}).values()
    direct = [block for block in blocks if block is not None and not isinstance(block, bytes)]
    return direct + [scale for block in direct for scale in _scales(block)]


def _codes(log: Any) -> _Codes:
    return MDF4_CODES if log.version >= "4" else MDF3_CODES
