"""From frames to streams: which frames are which message, and whose they are."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hitchid.readers.formats.can.database import NULL_ADDRESS, Definition, node, parameter_group


class Frame(NamedTuple):
    """One frame of a log.

    Attributes:
        stamp_s: time, s, from any origin.
        bus: number of the bus as the log has it.
        identifier: 11 or 29 bits.
        extended: whether it has 29.
        data: its bytes; none where some are missing, None for an error or a remote frame.
    """

    stamp_s: float
    bus: int
    identifier: int
    extended: bool
    data: bytes | None


@dataclass
class Stream:
    """The frames one node sends of one message on one bus; `node` and `assumed` as `Match` has them."""

    definition: Definition
    bus: int
    node: int | None
    assumed: bool
    frames: list[tuple[float, bytes]] = field(default_factory=list)
    short: int = 0


class Match(NamedTuple):
    """A message an id may stand for, the node that sends it by J1939, whether J1939 is only assumed."""

    definition: Definition
    node: int | None
    assumed: bool


def _matcher(definitions: Sequence[Definition]) -> Callable[[int, bool], list[Match]]:
    """Return a function from an id to the messages it may stand for."""
    exact: dict[tuple[int, bool], list[Definition]] = {}
    groups: dict[tuple[int, bool], list[Definition]] = {}
    for each in definitions:
        if not each.grouped:
            exact.setdefault((each.identifier, each.extended), []).append(each)
        if each.grouped or each.unsaid:
            groups.setdefault((parameter_group(each.identifier), each.unsaid), []).append(each)

    def matches(identifier: int, extended: bool) -> list[Match]:
        found = [Match(each, None, False) for each in exact.get((identifier, extended), [])]
        if extended:
            for unsaid in (False, True):
                group = groups.get((parameter_group(identifier), unsaid), [])
                meant = _of_node(group, node(identifier))
                own = [each for each in meant if not (unsaid and each.identifier == identifier)]
                found += [Match(each, node(identifier), unsaid) for each in own]
        return found

    return matches


class Heard(NamedTuple):
    """What is in a log: streams, the 29-bit ids met, its first stamp, frames without data, data frames."""

    streams: list[Stream]
    extended: set[int]
    first_s: float
    without_data: int
    frames: int


def listen(
    frames: Iterable[Frame], definitions: Sequence[Definition], keeps: Callable[[Definition], bool]
) -> Heard:
    """Sort the frames of the messages that are kept into streams; of the others, note that they come."""
    matches = _matcher(definitions)
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
        into = routes.get((bus, extended, identifier))
        if into is None:
            met = [
                streams.setdefault((it.definition.name, bus, *it[1:]), Stream(it.definition, bus, *it[1:]))
                for it in matches(identifier, extended)
            ]
            into = routes[bus, extended, identifier] = [each for each in met if keeps(each.definition)]
        for stream in into:
            if len(data) < stream.definition.length:
                stream.short += 1
            else:
                stream.frames.append((stamp_s, data))
    ids = {identifier for _, extended, identifier in routes if extended}
    return Heard(_sure(list(streams.values())), ids, first_s, without_data, count)


def _sure(streams: Sequence[Stream]) -> list[Stream]:
    """Leave out what was only assumed to be a message whose very id is in the log."""
    met = {each.definition.name for each in streams if not each.assumed}
    return [each for each in streams if not (each.assumed and each.definition.name in met)]


def _of_node(group: Sequence[Definition], address: int) -> list[Definition]:
    """Return the definitions of one parameter group that hold for a node."""
    own = [each for each in group if node(each.identifier) == address]
    of_any = [each for each in group if node(each.identifier) == NULL_ADDRESS]
    # One node's definition stands for all nodes unless the database tells them apart.
    alone = list(group) if len({node(each.identifier) for each in group}) == 1 else []
    return own or of_any or alone
