"""From the bytes of frames to the numbers of one signal."""

import numpy as np
from jaxtyping import Bool, Float64, UInt8, UInt64

from hitchid.readers.formats.can.database import CanMessage, CanSignal

Payload = UInt8[np.ndarray, "frames bytes"]


def raw_numbers(payload: Payload, signal: CanSignal) -> UInt64[np.ndarray, " frames"]:
    """Return the bits of a signal in each frame as an unsigned number.

    All frames at once, without cantools: it refuses a whole frame for one multiplexer value that is not in
    the database, and takes several microseconds a frame.
    """
    positions = signal.bit_positions
    first, last = int(positions.min()) // 8, int(positions.max()) // 8
    bits = np.unpackbits(payload[:, first : last + 1], axis=1, bitorder="little")[:, positions - 8 * first]
    packed = np.packbits(bits, axis=1, bitorder="little")
    padded = np.zeros((len(payload), 8), dtype=np.uint8)
    padded[:, : packed.shape[1]] = packed
    return padded.view("<u8")[:, 0].astype(np.uint64)


def physical_values(raw: UInt64[np.ndarray, " frames"], signal: CanSignal) -> Float64[np.ndarray, " frames"]:
    """Return raw numbers in the unit of the signal."""
    return _as_typed(raw, signal).astype(np.float64) * signal.scale + signal.offset


def _as_typed(raw: np.ndarray, signal: CanSignal) -> np.ndarray:
    if signal.is_float:
        size = signal.length // 8
        return raw.astype(f"u{size}").view(f"f{size}")
    if signal.signed:
        unused = np.uint64(64 - signal.length)
        return (raw << unused).view(np.int64) >> unused.astype(np.int64)
    return raw


def frames_with_signal(
    payload: Payload, signal: CanSignal, message: CanMessage
) -> Bool[np.ndarray, " frames"]:
    """Return which frames hold a signal, by their multiplexer values."""
    by_name = {candidate.name: candidate for candidate in message.signals}
    present = np.ones(len(payload), dtype=bool)
    # At most as many steps as there are signals: a damaged database may let a multiplexer select itself.
    for _ in message.signals:
        if signal.multiplexer is None:
            break
        if signal.multiplexer not in by_name:
            return np.zeros(len(payload), dtype=bool)
        multiplexer = by_name[signal.multiplexer]
        present &= np.isin(
            raw_numbers(payload, multiplexer), np.array(signal.multiplexer_values, dtype=np.uint64)
        )
        signal = multiplexer
    return present


def available(raw: UInt64[np.ndarray, " frames"], signal: CanSignal) -> Bool[np.ndarray, " frames"]:
    """Return which raw numbers of a J1939 signal are valid.

    In unsigned signals of 1 to 4 bytes 0xFF.. is 'not available', 0xFE.. an error, and the rest from 0xFB..
    on reserved. In 2 to 7 bits all ones is 'not available' and one less an error. In all others only all ones
    is invalid, and a single bit is always valid.

    Source: SAE J1939-71, ranges of transmitted signals.
    """
    all_ones = 2**signal.length - 1
    if signal.length == 1:
        return np.ones(raw.size, dtype=bool)
    if signal.signed or signal.is_float:
        return raw != np.uint64(all_ones)
    if signal.length in (8, 16, 24, 32):
        return raw < np.uint64(0xFB << (signal.length - 8))
    return raw < np.uint64(all_ones - 1 if signal.length < 8 else all_ones)
