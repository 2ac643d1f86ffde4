"""From the bytes of frames to the numbers of one signal."""

import numpy as np
from jaxtyping import Bool, Float64, UInt8, UInt64

from hitchid.readers.formats.can.database import Definition, Field

Payload = UInt8[np.ndarray, "frames bytes"]


def raw_numbers(payload: Payload, field: Field) -> UInt64[np.ndarray, " frames"]:
    """Return the bits of a signal in each frame as an unsigned number.

    Bits are taken here, not by cantools frame by frame: it refuses a whole frame for one multiplexer value
    that the database does not list, and takes several microseconds for each.
    """
    places = field.places
    first, last = int(places.min()) // 8, int(places.max()) // 8
    bits = np.unpackbits(payload[:, first : last + 1], axis=1, bitorder="little")[:, places - 8 * first]
    packed = np.packbits(bits, axis=1, bitorder="little")
    wide = np.zeros((len(payload), 8), dtype=np.uint8)
    wide[:, : packed.shape[1]] = packed
    return wide.view("<u8")[:, 0].astype(np.uint64)


def physical(raw: UInt64[np.ndarray, " frames"], field: Field) -> Float64[np.ndarray, " frames"]:
    """Return raw numbers in the unit of the signal."""
    return _as_typed(raw, field).astype(np.float64) * field.scale + field.offset


def _as_typed(raw: np.ndarray, field: Field) -> np.ndarray:
    if field.floating:
        size = field.length // 8
        return raw.astype(f"u{size}").view(f"f{size}")
    if field.signed:
        unused = np.uint64(64 - field.length)
        return (raw << unused).view(np.int64) >> unused.astype(np.int64)
    return raw


def selected(payload: Payload, field: Field, definition: Definition) -> Bool[np.ndarray, " frames"]:
    """Return which frames hold a signal by what their multiplexers say."""
    by_name = {each.name: each for each in definition.fields}
    there = np.ones(len(payload), dtype=bool)
    # At most as many steps as there are signals: a damaged database may let a multiplexer select itself.
    for _ in definition.fields:
        if field.selector is None:
            break
        if field.selector not in by_name:
            return np.zeros(len(payload), dtype=bool)
        selector = by_name[field.selector]
        there &= np.isin(raw_numbers(payload, selector), np.array(field.selected_by, dtype=np.uint64))
        field = selector
    return there


def available(raw: UInt64[np.ndarray, " frames"], field: Field) -> Bool[np.ndarray, " frames"]:
    """Return which raw numbers of a J1939 signal are measured ones.

    Of unsigned signals of 1 to 4 bytes those from 0xFB.. on are none: 0xFF.. is 'not available', 0xFE.. an
    error, the rest reserved. Of 2 to 7 bits all ones is 'not available' and one less an error. Of any
    other only all ones counts, and one bit is always a number: J1939 leaves no room in it.

    Source: SAE J1939-71, ranges of transmitted signals.
    """
    full = 2**field.length - 1
    if field.length == 1:
        return np.ones(raw.size, dtype=bool)
    if field.signed or field.floating:
        return raw != np.uint64(full)
    if field.length in (8, 16, 24, 32):
        return raw < np.uint64(0xFB << (field.length - 8))
    return raw < np.uint64(full - 1 if field.length < 8 else full)
