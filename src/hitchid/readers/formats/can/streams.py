"""From frames to streams: the message and the sending node of each frame."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hitchid.readers.formats.can.database import NULL_ADDRESS, CanMessage, node, parameter_group


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
    """The frames one node sends of one message on one bus; `node` and `j1939_assumed` as `MessageMatch` has
    them."""

    message: CanMessage
    bus: int
    node: int | None
    j1939_assumed: bool
    frames: list[tuple[float, bytes]] = field(default_factory=list)
    short_count: int = 0


class MessageMatch(NamedTuple):
    """A possible message of an id, the sending node by J1939, and whether J1939 is only assumed."""

    message: CanMessage
    node: int | None
    j1939_assumed: bool


def _message_matcher(messages: Sequence[CanMessage]) -> Callable[[int, bool], list[MessageMatch]]:
    """Return a function from an id to its possible messages."""
    exact: dict[tuple[int, bool], list[CanMessage]] = {}
    groups: dict[tuple[int, bool], list[CanMessage]] = {}
    for message in messages:
        if not message.is_j1939:
            exact.setdefault((message.identifier, message.extended), []).append(message)
        if message.is_j1939 or message.maybe_j1939:
            groups.setdefault((parameter_group(message.identifier), message.maybe_j1939), []).append(message)

    def matches(identifier: int, extended: bool) -> list[MessageMatch]:
        candidates = [MessageMatch(message, None, False) for message in exact.get((identifier, extended), [])]
        if extended:
            for maybe_j1939 in (False, True):
                group = groups.get((parameter_group(identifier), maybe_j1939), [])
                node_messages = _messages_of_node(group, node(identifier))
                accepted = [
                    message
                    for message in node_messages
                    if not (maybe_j1939 and message.identifier == identifier)
                ]
                candidates += [MessageMatch(message, node(identifier), maybe_j1939) for message in accepted]
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
        if not count:
            first_s = stamp_s
        count += 1
        targets = routes.get((bus, extended, identifier))
        if targets is None:
            matched_streams = [
                streams.setdefault(
                    (message_match.message.name, bus, *message_match[1:]),
                    Stream(message_match.message, bus, *message_match[1:]),
                )
                for message_match in matches(identifier, extended)
            ]
            targets = routes[bus, extended, identifier] = [
                candidate for candidate in matched_streams if message_filter(candidate.message)
            ]
        for stream in targets:
            if len(data) < stream.message.length:
                stream.short_count += 1
            else:
                stream.frames.append((stamp_s, data))
    ids = {identifier for _, extended, identifier in routes if extended}
    return BusTraffic(_without_assumed_duplicates(list(streams.values())), ids, first_s, without_data, count)


def _without_assumed_duplicates(streams: Sequence[Stream]) -> list[Stream]:
    """Remove streams assumed to be a message whose exact id is in the log."""
    exact_names = {stream.message.name for stream in streams if not stream.j1939_assumed}
    return [stream for stream in streams if not (stream.j1939_assumed and stream.message.name in exact_names)]


def _messages_of_node(group: Sequence[CanMessage], address: int) -> list[CanMessage]:
    """Return the definitions of one parameter group that apply to a node."""
    exact = [message for message in group if node(message.identifier) == address]
    any_node = [message for message in group if node(message.identifier) == NULL_ADDRESS]
    # A definition for one node applies to all nodes if it is the only one in the database.
    shared = list(group) if len({node(message.identifier) for message in group}) == 1 else []
    return exact or any_node or shared
