"""From the frames of a log to the requested channels."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel, format_names, match_channels
from hitchid.logs.formats.can_database import (
    CanMessage,
    CanSignal,
    node,
    parameter_group,
    read_databases,
)
from hitchid.logs.formats.can_decoder import (
    BusTraffic,
    Frame,
    Stream,
    available,
    collect_streams,
    frames_with_signal,
    physical_values,
    raw_numbers,
)

Location = tuple[Stream, CanSignal]  # where the samples of a channel are


def read_bus(frames: Iterable[Frame], source: Path, selection: ChannelSelection) -> Content:
    """Decode the selected signals of the frames of a log.

    A channel's full name is `Message/Signal`. A message on several buses, or from several J1939 nodes, has
    channels for each: `Message@can2/Signal`, `Message@0x03/Signal` or `Message@can2@0x03/Signal`. The long
    names are always accepted, a shorter one if it is unique.

    Messages are matched by id. Those of J1939 and ISO 11783 are matched by parameter group, from any node, at
    any priority, to any destination, without samples that are 'not available' by J1939. They are marked in
    the database (`VFrameFormat` J1939PG, or `ProtocolType` for the whole database); in a database without
    marks they are also those whose id ends in 0xFE, the null address, unless that very id is in the log.
    Other 29-bit ids are matched exactly: their low byte distinguishes messages, not nodes. If several
    databases define one id, the requested name decides.

    Messages of several frames (J1939 transport protocol) are not reassembled.
    """
    messages, database_notices = read_databases(selection.databases, source)
    requested_names = {name.rpartition("/")[2] for name in (selection.time, *(selection.signals or ()))}

    def may_hold_requested(message: CanMessage) -> bool:
        return selection.signals is None or any(s.name in requested_names for s in message.signals)

    # The frames of all other messages, most of a busy bus, are counted and dropped.
    traffic = collect_streams(frames, messages, may_hold_requested)
    if not traffic.frame_count:
        raise LogError(source, "holds no CAN frames with data")
    locations, aliases = _channel_names(traffic.streams)
    matches = _match_requested(source, selection, aliases, messages, traffic, list(locations))
    located = {requested: locations[name] for requested, name in matches.items()}
    required = selection.signals is not None
    channels, notices = _channels(source, traffic.first_s, located, required=required)
    if not channels:
        raise LogError(source, f"none of its {traffic.frame_count} frames holds a signal of the DBC files")
    if traffic.without_data:
        notices.insert(0, f"{traffic.without_data} error and remote frames are left out")
    return Content(source, channels, (*database_notices, *notices))


def _channel_names(streams: Sequence[Stream]) -> tuple[dict[str, Location], dict[str, list[str]]]:
    """Return full name to location, and every alias to the full names it may stand for."""
    buses = Counter(name for name, _ in {(stream.message.name, stream.bus) for stream in streams})
    nodes = Counter(name for name, _ in {(stream.message.name, stream.node) for stream in streams})
    locations: dict[str, Location] = {}
    aliases: dict[str, list[str]] = {}
    for stream in streams:
        name = stream.message.name
        bus_suffix, node_suffix = f"@can{stream.bus}", "" if stream.node is None else f"@{stream.node:#04x}"
        full_name = name + (bus_suffix if buses[name] > 1 else "") + (node_suffix if nodes[name] > 1 else "")
        for signal in stream.message.signals:
            locations[f"{full_name}/{signal.name}"] = stream, signal
            for alias in {name, name + bus_suffix, name + node_suffix, name + bus_suffix + node_suffix}:
                aliases.setdefault(f"{alias}/{signal.name}", []).append(f"{full_name}/{signal.name}")
    return locations, aliases


def _match_requested(
    source: Path,
    selection: ChannelSelection,
    aliases: dict[str, list[str]],
    messages: Sequence[CanMessage],
    traffic: BusTraffic,
    names: list[str],
) -> dict[str, str]:
    """Return requested name to full name, as `match_channels` does."""
    if selection.signals is None:
        return match_channels(source, names, selection, has_clocks=True)
    matches: dict[str, str] = {}
    all_requested = dict.fromkeys((selection.time, *selection.signals))
    for requested in all_requested:
        candidates = aliases.get(requested, [])
        if len(candidates) > 1:
            problem = f"several channels have this name; use the full name: {format_names(candidates)}"
            raise LogError(source, problem, column=requested)
        if candidates:
            matches[requested] = candidates[0]
        elif requested != selection.time and requested not in {name.rpartition("/")[2] for name in names}:
            _check_not_in_log(source, requested, messages, traffic)
    remaining = selection._replace(
        signals=tuple(requested for requested in selection.signals if requested not in matches)
    )
    matches |= match_channels(source, names, remaining, has_clocks=True)
    return {requested: matches[requested] for requested in all_requested if requested in matches}


def _check_not_in_log(
    source: Path, requested: str, messages: Sequence[CanMessage], traffic: BusTraffic
) -> None:
    """Raise `LogError` if a channel is in a database but its message is not in the log."""
    for message in messages:
        if requested not in {
            name for signal in message.signals for name in (signal.name, f"{message.name}/{signal.name}")
        }:
            continue
        problem = (
            f"the message '{message.name}' of this signal, id {message.identifier:#x}, is not in the log"
        )
        group = parameter_group(message.identifier)
        nodes = [
            f"{node(identifier):#04x}"
            for identifier in sorted(traffic.extended_ids)
            if parameter_group(identifier) == group
        ]
        if message.extended and nodes:
            problem += (
                f"; frames with its PGN {group} are in the log, from source address {format_names(nodes)}"
            )
        if message.extended and nodes and not message.is_j1939:
            problem += ": if the bus is J1939, set VFrameFormat 'J1939PG' in the DBC file"
        raise LogError(source, problem, column=requested)


def _channels(
    source: Path, first_s: float, locations: Mapping[str, Location], *, required: bool
) -> tuple[dict[str, LogChannel], list[str]]:
    """Return channels and notices; a channel without a valid sample is an error if `required`."""
    channels: dict[str, LogChannel] = {}
    streams = {id(stream): stream for stream, _ in locations.values()}
    notices, empty = list(_stream_notices(streams.values())), []
    stamps_s, payloads = {}, {}
    for key, stream in streams.items():
        length = stream.message.length
        stamps_s[key] = np.array([stamp_s for stamp_s, _ in stream.frames], dtype=np.float64) - first_s
        all_bytes = b"".join(data[:length] for _, data in stream.frames)
        payloads[key] = np.frombuffer(all_bytes, dtype=np.uint8).reshape(len(stream.frames), length)
    clocks: dict[tuple[int, bytes], np.ndarray] = {}
    for requested, (stream, signal) in locations.items():
        payload, clock_s = payloads[id(stream)], stamps_s[id(stream)]
        present = frames_with_signal(payload, signal, stream.message)
        raw = raw_numbers(payload, signal)
        present_count = int(present.sum())
        if stream.node is not None:
            present &= available(raw, signal)
        values = physical_values(raw[present], signal)
        unavailable_count = present_count - int(present.sum())
        if not values.size:
            if required:
                raise LogError(source, _empty_reason(stream, unavailable_count), column=requested)
            empty.append(requested)
            continue
        if unavailable_count:
            count = f"{unavailable_count} of {present_count} samples"
            notices.append(f"'{requested}': {count} are left out: not valid in J1939")
        # Channels on one clock share one array: the record is cut and resampled by clocks.
        frames_key = id(stream), np.packbits(present).tobytes()
        clock_s = clocks.setdefault(frames_key, clock_s if present.all() else clock_s[present])
        channels[requested] = LogChannel(values, signal.unit, clock_s)
    if empty:
        notices.append(f"left out because no sample is valid: {format_names(empty)}")
    return channels, notices


def _stream_notices(streams: Iterable[Stream]) -> Iterator[str]:
    for stream in streams:
        name, count = stream.message.name, stream.short_count + len(stream.frames)
        if stream.short_count:
            yield (
                f"'{name}': {stream.short_count} of {count} frames are left out: shorter than "
                f"{stream.message.length} bytes"
            )
        if stream.j1939_assumed:
            identifier = stream.message.identifier
            yield (
                f"'{name}' was matched by its PGN {parameter_group(identifier)}, from source address "
                f"{stream.node:#04x}: the id in the DBC file, {identifier:#x}, has the null address"
            )


def _empty_reason(stream: Stream, unavailable_count: int) -> str:
    if unavailable_count:
        return f"all {unavailable_count} samples are 'not available' or 'error' in J1939"
    if stream.frames:
        return "no frame contains it: its multiplexer never selects it"
    return f"all frames of its message are shorter than {stream.message.length} bytes"
