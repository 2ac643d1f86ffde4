"""From the frames of a log to the channels that are asked for."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.readers.content import Channel, Content, Wanted, chosen, listed
from hitchid.readers.formats.can.bits import Payload, available, physical, raw_numbers, selected
from hitchid.readers.formats.can.database import (
    Databases,
    Definition,
    Field,
    node,
    parameter_group,
    read_databases,
)
from hitchid.readers.formats.can.streams import Frame, Heard, Stream, listen


class _Place(NamedTuple):
    """Where one channel is found."""

    stream: Stream
    field: Field


def read_bus(frames: Iterable[Frame], source: Path, wanted: Wanted) -> Content:
    """Decode the wanted signals of the frames of a log.

    A channel's full name is `Message/Signal`. Where a message comes on several buses, or from several nodes
    of J1939, each has its own channels: `Message@can2/Signal`, `Message@0x03/Signal` or, where both,
    `Message@can2@0x03/Signal`. These may always be asked for; a shorter name suffices where it means one.

    A message is met by its id. Messages of J1939 and ISO 11783 are met by their parameter group, from any
    node, at any priority, to any destination, and what is 'not available' by J1939's ranges is left out.
    They are those the database marks so (`VFrameFormat` J1939PG, or `ProtocolType` for all of it); in a
    database that marks nothing also those whose id ends in 0xFE, an address no node sends from, unless that
    very id is in the log. Other 29-bit ids are met exactly: the low byte of an id that is not of J1939 tells
    messages apart, not nodes. Several databases may define one id; what is asked for says which is meant.

    Messages of several frames by J1939's transport protocol are not put together.

    Args:
        frames: in the order of the log.
        source: the log.
        wanted: what is asked for; None gives every signal that comes in the log.

    Raises:
        LogError: a database is missing or cannot be read, or a wanted signal is not there or never a number.
    """
    databases = read_databases(wanted.databases, source)
    heard = listen(frames, databases.definitions, _keeps(wanted))
    if not heard.frames:
        raise LogError(source, "holds no CAN frames with data")
    places, spellings = _names(heard.streams)
    found = _found(source, wanted, spellings, databases, heard, list(places))
    read = _Reading(source, heard.first_s, {asked: places[name] for asked, name in found.items()})
    channels, notices = read.channels(required=wanted.signals is not None)
    if not channels:
        raise LogError(source, f"none of its {heard.frames} frames holds a signal of the DBC files")
    return Content(source, channels, (*databases.notices, *_odd(heard), *notices))


def _keeps(wanted: Wanted) -> Callable[[Definition], bool]:
    """Return a function that says whether a message may hold what is asked for."""
    if wanted.signals is None:
        return lambda _: True
    last = {asked.rpartition("/")[2] for asked in (wanted.time, *wanted.signals)}
    return lambda definition: any(each.name in last for each in definition.fields)


def _names(streams: Sequence[Stream]) -> tuple[dict[str, _Place], dict[str, list[str]]]:
    """Return full name to place, and every other way to write a name to the full names it may mean."""
    buses = Counter(name for name, _ in {(each.definition.name, each.bus) for each in streams})
    nodes = Counter(name for name, _ in {(each.definition.name, each.node) for each in streams})
    places: dict[str, _Place] = {}
    spellings: dict[str, list[str]] = {}
    for stream in streams:
        name = stream.definition.name
        bus, sender = f"@can{stream.bus}", "" if stream.node is None else f"@{stream.node:#04x}"
        full = name + (bus if buses[name] > 1 else "") + (sender if nodes[name] > 1 else "")
        for each in stream.definition.fields:
            places[f"{full}/{each.name}"] = _Place(stream, each)
            for written in {name, name + bus, name + sender, name + bus + sender}:
                spellings.setdefault(f"{written}/{each.name}", []).append(f"{full}/{each.name}")
    return places, spellings


def _found(
    source: Path,
    wanted: Wanted,
    spellings: dict[str, list[str]],
    databases: Databases,
    heard: Heard,
    names: list[str],
) -> dict[str, str]:
    """Return the name each channel is asked by to its full name, as `content.chosen` does."""
    if wanted.signals is None:
        return chosen(source, names, wanted, clocked=True)
    found: dict[str, str] = {}
    for asked in dict.fromkeys((wanted.time, *wanted.signals)):
        meant = spellings.get(asked, [])
        if len(meant) > 1:
            raise LogError(source, f"several channels are meant: {listed(meant)}", column=asked)
        if meant:
            found[asked] = meant[0]
        elif asked != wanted.time and asked not in {name.rpartition("/")[2] for name in names}:
            _check_unheard(source, asked, databases.definitions, heard)
    rest = wanted._replace(signals=tuple(asked for asked in wanted.signals if asked not in found))
    found |= chosen(source, names, rest, clocked=True)
    return {asked: found[asked] for asked in dict.fromkeys((wanted.time, *wanted.signals)) if asked in found}


def _check_unheard(source: Path, asked: str, definitions: Sequence[Definition], heard: Heard) -> None:
    """Raise `LogError` if a channel is in a database but its message is not in the log."""
    for each in definitions:
        if asked not in {part for own in each.fields for part in (own.name, f"{each.name}/{own.name}")}:
            continue
        problem = f"its message '{each.name}', id {each.identifier:#x}, does not come in the log"
        group = parameter_group(each.identifier)
        nodes = [f"{node(met):#04x}" for met in sorted(heard.extended) if parameter_group(met) == group]
        if each.extended and nodes:
            problem += f"; its parameter group {group} does, from {listed(nodes)}"
        if each.extended and nodes and not each.grouped:
            problem += ": where the bus is J1939, let the DBC file say so by VFrameFormat 'J1939PG'"
        raise LogError(source, problem, column=asked)


class _Block(NamedTuple):
    """Frames of one stream: their times, s, and their bytes."""

    clock_s: np.ndarray
    payload: Payload


@dataclass(frozen=True)
class _Reading:
    """Channels to be read: the log, its first stamp, where each is found."""

    source: Path
    first_s: float
    places: dict[str, _Place]

    def channels(self, *, required: bool) -> tuple[dict[str, Channel], list[str]]:
        """Return the channels and the notices; one without a number is an error only where required."""
        channels: dict[str, Channel] = {}
        notices, empty = list(self._stream_notices()), []
        blocks = {id(place.stream): _block(place.stream, self.first_s) for place in self.places.values()}
        clocks: dict[tuple[int, bytes], np.ndarray] = {}
        for asked, place in self.places.items():
            block = blocks[id(place.stream)]
            values, there, dropped = _decoded(block.payload, place)
            if not values.size:
                if required:
                    raise LogError(self.source, _why_empty(place, dropped), column=asked)
                empty.append(asked)
                continue
            if dropped:
                of = values.size + dropped
                notices.append(
                    f"'{asked}': {dropped} of {of} samples are left out: J1939 has no number in them"
                )
            # Channels on one clock share one array: the record is cut and resampled by clocks.
            key = id(place.stream), np.packbits(there).tobytes()
            shared = clocks.setdefault(key, block.clock_s if there.all() else block.clock_s[there])
            channels[asked] = Channel(values, place.field.unit, shared)
        if empty:
            notices.append(f"left out, for they never hold a number: {listed(empty)}")
        return channels, notices

    def _stream_notices(self) -> Iterator[str]:
        for stream in {id(place.stream): place.stream for place in self.places.values()}.values():
            name, count = stream.definition.name, stream.short + len(stream.frames)
            if stream.short:
                yield (
                    f"'{name}': {stream.short} of {count} frames are left out: shorter than "
                    f"{stream.definition.length} bytes"
                )
            if stream.assumed:
                identifier = stream.definition.identifier
                yield (
                    f"'{name}' was met by its parameter group {parameter_group(identifier)}, from "
                    f"{stream.node:#04x}: the id in the DBC file, {identifier:#x}, is of no node"
                )


def _block(stream: Stream, first_s: float) -> _Block:
    length = stream.definition.length
    stamps = np.array([stamp_s for stamp_s, _ in stream.frames], dtype=np.float64)
    joined = b"".join(data[:length] for _, data in stream.frames)
    return _Block(stamps - first_s, np.frombuffer(joined, dtype=np.uint8).reshape(stamps.size, length))


def _decoded(payload: Payload, place: _Place) -> tuple[np.ndarray, np.ndarray, int]:
    """Return a signal's numbers, which frames they are of, and how many it had that J1939 calls none."""
    there = selected(payload, place.field, place.stream.definition)
    raw = raw_numbers(payload, place.field)
    held = int(there.sum())
    if place.stream.node is not None:
        there &= available(raw, place.field)
    return physical(raw[there], place.field), there, held - int(there.sum())


def _why_empty(place: _Place, dropped: int) -> str:
    if dropped:
        return f"all {dropped} samples are 'not available' or an error by J1939"
    if place.stream.frames:
        return "no frame holds it: its multiplexer never selects it"
    return f"all frames of its message are shorter than {place.stream.definition.length} bytes"


def _odd(heard: Heard) -> Iterator[str]:
    if heard.without_data:
        yield f"{heard.without_data} error and remote frames are left out"
