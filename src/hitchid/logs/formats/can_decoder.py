"""Decoder of a CAN bus: frames to streams of one message and sending node, payloads to numbers of signals."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, UInt8, UInt64

from hitchid.logs.formats.can_database import NULL_ADDRESS, CanMessage, CanSignal, node, parameter_group

# From the bytes of frames to the numbers of one signal.

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
    numbers: np.ndarray = raw
    if signal.is_float:
        size = signal.length // 8
        numbers = raw.astype(f"u{size}").view(f"f{size}")
    elif signal.signed:
        unused = np.uint64(64 - signal.length)
        numbers = (raw << unused).view(np.int64) >> unused.astype(np.int64)
    return numbers.astype(np.float64) * signal.scale + signal.offset


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


class Frame(NamedTuple):
    """One frame of a log.

    Attributes:
        stamp_s: time, s, from any origin.
        bus: number of the bus in the log.
        identifier: 11 or 29 bits.
        extended: whether the identifier has 29 bits.
        data: its bytes, empty if some are missing; None for an error or a remote frame.
    """

    stamp_s: float
    bus: int
    identifier: int
    extended: bool
    data: bytes | None


@dataclass
class Stream:
    """The frames one node sends of one message on one bus.

    Attributes:
        message: the message.
        bus: number of the bus.
        node: the sending node by J1939; None for any other message.
        j1939_assumed: whether J1939 is only assumed.
        frames: stamp and bytes of each.
        short_count: number of frames with less bytes than the message has.
    """

    message: CanMessage
    bus: int
    node: int | None
    j1939_assumed: bool
    frames: list[tuple[float, bytes]] = field(default_factory=list)
    short_count: int = 0


def _message_matcher(
    messages: Sequence[CanMessage],
) -> Callable[[int, bool], list[tuple[CanMessage, int | None, bool]]]:
    """Return a function from an id to its possible messages, each with `node` and `j1939_assumed`."""
    exact: dict[tuple[int, bool], list[CanMessage]] = {}
    groups: dict[tuple[int, bool], list[CanMessage]] = {}
    for message in messages:
        if not message.is_j1939:
            exact.setdefault((message.identifier, message.extended), []).append(message)
        if message.is_j1939 or message.maybe_j1939:
            groups.setdefault((parameter_group(message.identifier), message.maybe_j1939), []).append(message)

    def matches(identifier: int, extended: bool) -> list[tuple[CanMessage, int | None, bool]]:
        candidates: list[tuple[CanMessage, int | None, bool]] = [
            (message, None, False) for message in exact.get((identifier, extended), [])
        ]
        if extended:
            for maybe_j1939 in (False, True):
                group = groups.get((parameter_group(identifier), maybe_j1939), [])
                candidates += [
                    (message, node(identifier), maybe_j1939)
                    for message in _messages_of_node(group, node(identifier))
                    if not (maybe_j1939 and message.identifier == identifier)
                ]
        return candidates

    return matches


class BusTraffic(NamedTuple):
    """Content of a log: streams, 29-bit ids, first stamp, counts of frames without and with data."""

    streams: list[Stream]
    extended_ids: set[int]
    first_s: float
    without_data: int
    frame_count: int


def collect_streams(
    frames: Iterable[Frame], messages: Sequence[CanMessage], message_filter: Callable[[CanMessage], bool]
) -> BusTraffic:
    """Sort the frames of the messages that pass the filter into streams; of the others, record the ids."""
    matches = _message_matcher(messages)
    streams: dict[tuple[str, int, int | None, bool], Stream] = {}
    routes: dict[tuple[int, bool, int], list[Stream]] = {}
    first_s, without_data, count = 0.0, 0, 0
    for frame in frames:
        stamp_s, bus, identifier, extended, data = frame
        if data is None:
            without_data += 1
            continue
        # Times count from the first frame with data: no other is used.
        if not count:
            first_s = stamp_s
        count += 1
        # Looked up once for each id: a log has millions of frames, a bus some hundred ids.
        targets = routes.get((bus, extended, identifier))
        if targets is None:
            matched = [
                streams.setdefault(
                    (message.name, bus, node_address, assumed), Stream(message, bus, node_address, assumed)
                )
                for message, node_address, assumed in matches(identifier, extended)
            ]
            targets = [stream for stream in matched if message_filter(stream.message)]
            routes[bus, extended, identifier] = targets
        for stream in targets:
            if len(data) < stream.message.length:
                stream.short_count += 1
            else:
                stream.frames.append((stamp_s, data))
    ids = {identifier for _, extended, identifier in routes if extended}
    # A stream is not assumed to be a message whose exact id is in the log.
    exact = {stream.message.name for stream in streams.values() if not stream.j1939_assumed}
    kept = [s for s in streams.values() if not (s.j1939_assumed and s.message.name in exact)]
    return BusTraffic(kept, ids, first_s, without_data, count)


def _messages_of_node(group: Sequence[CanMessage], address: int) -> list[CanMessage]:
    """Return the definitions of one parameter group that apply to a node."""
    exact = [message for message in group if node(message.identifier) == address]
    any_node = [message for message in group if node(message.identifier) == NULL_ADDRESS]
    # A definition for one node applies to all nodes if it is the only one in the database.
    shared = list(group) if len({node(message.identifier) for message in group}) == 1 else []
    return exact or any_node or shared
