"""DBC databases: which messages are on a CAN bus, and how their signals lie in the frames."""

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.readers.formats.extra import damage, needed, spelled

NULL_ADDRESS = 0xFE
LONGEST = 64


class Field(NamedTuple):
    """How one signal lies in a frame, in the terms of a DBC.

    Attributes:
        name: of the signal.
        unit: as the database spells it, None where it says nothing.
        start: the least significant bit, for Motorola's byte order the most significant one.
        length: bits.
        intel: whether the least significant byte comes first.
        signed: whether it is a two's complement.
        floating: whether it is an IEEE 754 number.
        scale: physical units a raw one.
        offset: physical value of raw zero.
        selector: the multiplexer that says whether a frame holds it, None where each does.
        selected_by: values of the multiplexer at which it is there.
    """

    name: str
    unit: str | None
    start: int
    length: int
    intel: bool
    signed: bool
    floating: bool
    scale: float
    offset: float
    selector: str | None
    selected_by: tuple[int, ...]

    @property
    def places(self) -> np.ndarray:
        """Where its bits are, the least significant one first; bit b of byte n is at 8 n + b."""
        if self.intel:
            return self.start + np.arange(self.length)
        # Motorola counts on from the most significant bit, within each byte from bit 7 to bit 0.
        first = 8 * (self.start // 8) + 7 - self.start % 8
        counted = (first + np.arange(self.length))[::-1]
        return 8 * (counted // 8) + 7 - counted % 8


class Definition(NamedTuple):
    """One message of a database.

    Attributes:
        name: of the message; with the database's name before it where another's differs from it.
        identifier: id of its frames, 11 or 29 bits.
        extended: whether the id has 29 bits.
        length: bytes.
        fields: its signals.
        grouped: whether the database says it is of J1939 or ISO 11783: a parameter group of any node.
        unsaid: whether it may be such a group, though the database says nothing of it.
    """

    name: str
    identifier: int
    extended: bool
    length: int
    fields: tuple[Field, ...]
    grouped: bool
    unsaid: bool


class Databases(NamedTuple):
    """What several databases say.

    Attributes:
        definitions: their messages, each once.
        notices: what the user should know of how they were read.
    """

    definitions: tuple[Definition, ...]
    notices: tuple[str, ...]


def read_databases(paths: Sequence[Path], source: Path) -> Databases:
    """Read the DBC files that belong to a log.

    Args:
        paths: the DBC files.
        source: the log, for it is what cannot be read where there are none.

    Raises:
        LogError: there are none, cantools is missing, or one cannot be read.
    """
    if not paths:
        problem = (
            "required a DBC file: put it beside the log or name it in campaign.toml under [can] databases"
        )
        raise LogError(source, problem)
    needed("cantools", "can", source)
    read = {path: _read_database(path) for path in paths}
    definitions = _told_apart({path: each.definitions for path, each in read.items()})
    notices = [f"{path.name}: {notice}" for path, each in read.items() for notice in each.notices]
    return Databases(tuple(definitions), tuple(notices))


def parameter_group(identifier: int) -> int:
    """Return the number of the J1939 parameter group of a 29-bit id, the destination address left out."""
    group = (identifier >> 8) & 0x3FFFF
    # A format below 240 is sent to one node, whose address stands in the low byte.
    return group if (group >> 8) & 0xFF >= 240 else group & 0x3FF00


def node(identifier: int) -> int:
    """Return the source address in a 29-bit id of J1939."""
    return identifier & 0xFF


def _read_database(path: Path) -> Databases:
    with damage(path, "a DBC file"):
        read = _parsed(path.read_bytes())
    if not read.definitions:
        raise LogError(path, "holds no messages with signals; required a DBC file of what is on the bus")
    return read


# A large database takes seconds, and every log of a campaign asks for the same one.
@lru_cache(maxsize=8)
def _parsed(content: bytes) -> Databases:
    from cantools.database import load_string
    from cantools.database.errors import Error

    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    notices = ()
    try:
        database = load_string(text, database_format="dbc")
    except Error as error:
        # Databases in use often hold signals that overlap; what fits its message can still be read.
        database = load_string(text, database_format="dbc", strict=False)
        notices = (f"read, though not sound ({error}); signals that do not fit their message are left out",)
    return Databases(tuple(_definitions(database)), notices)


def _definitions(database: Any) -> Iterable[Definition]:
    attributes = database.dbc.attributes if database.dbc else {}
    said = bool(database.dbc) and "VFrameFormat" in database.dbc.attribute_definitions
    protocol = str(attributes["ProtocolType"].value) if "ProtocolType" in attributes else ""
    j1939 = protocol.replace(" ", "").upper().startswith(("J1939", "ISO11783"))
    for message in database.messages:
        extended = bool(message.is_extended_frame)
        unmarked = extended and not said
        grouped = extended and (message.protocol == "j1939" or (unmarked and j1939))
        fields = (_field(signal) for signal in message.signals if 0 < signal.length <= LONGEST)
        yield Definition(
            name=message.name,
            identifier=message.frame_id,
            extended=extended,
            length=message.length,
            fields=tuple(field for field in fields if field.places.max() < 8 * message.length),
            grouped=grouped,
            unsaid=unmarked and not grouped and node(message.frame_id) == NULL_ADDRESS,
        )


def _field(signal: Any) -> Field:
    return Field(
        name=signal.name,
        unit=spelled(signal.unit),
        start=signal.start,
        length=signal.length,
        intel=signal.byte_order == "little_endian",
        signed=bool(signal.is_signed),
        floating=bool(signal.conversion.is_float),
        scale=float(signal.conversion.scale),
        offset=float(signal.conversion.offset),
        selector=signal.multiplexer_signal,
        selected_by=tuple(signal.multiplexer_ids or ()),
    )


def _told_apart(read: dict[Path, tuple[Definition, ...]]) -> list[Definition]:
    """Put the database's name before messages that share a name and differ."""
    distinct: dict[Definition, Path] = {}
    for path, definitions in read.items():
        for definition in definitions:
            distinct.setdefault(definition, path)
    count = Counter(definition.name for definition in distinct)
    apart = {
        each._replace(name=f"{path.stem}.{each.name}") if count[each.name] > 1 else each: path
        for each, path in distinct.items()
    }
    taken: set[str] = set()
    for each, path in apart.items():
        if each.name in taken:
            raise LogError(path, f"several messages are named '{each.name}'; required one of each name")
        taken.add(each.name)
    return list(apart)
