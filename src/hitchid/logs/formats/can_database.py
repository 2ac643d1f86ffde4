"""DBC databases: the messages of a CAN bus, and the layout of their signals."""

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.formats.library import as_log_errors, import_optional, unit_text

NULL_ADDRESS = 0xFE  # source address of no node; SAE J1939-81
MAX_SIGNAL_BITS = 64  # bits of a raw number


class CanSignal(NamedTuple):
    """Layout of one signal in a frame, in the terms of a DBC.

    Attributes:
        name: of the signal.
        unit: as written in the database; None if it has none.
        start: the least significant bit, for Motorola's byte order the most significant one.
        length: bits.
        little_endian: whether the least significant byte comes first.
        signed: whether it is a two's complement.
        is_float: whether it is an IEEE 754 number.
        scale: physical units a raw one.
        offset: physical value of raw zero.
        multiplexer: the multiplexer that selects it; None if every frame holds it.
        multiplexer_values: values of the multiplexer that select it.
    """

    name: str
    unit: str | None
    start: int
    length: int
    little_endian: bool
    signed: bool
    is_float: bool
    scale: float
    offset: float
    multiplexer: str | None
    multiplexer_values: tuple[int, ...]

    @property
    def bit_positions(self) -> np.ndarray:
        """Positions of its bits, the least significant first; bit b of byte n is at 8 n + b."""
        if self.little_endian:
            return self.start + np.arange(self.length)
        # Motorola counts on from the most significant bit, within each byte from bit 7 to bit 0.
        first = 8 * (self.start // 8) + 7 - self.start % 8
        motorola_positions = (first + np.arange(self.length))[::-1]
        return 8 * (motorola_positions // 8) + 7 - motorola_positions % 8


class CanMessage(NamedTuple):
    """One message of a database.

    Attributes:
        name: of the message; after the database's name if another database defines it differently.
        identifier: id of its frames, 11 or 29 bits.
        extended: whether the id has 29 bits.
        length: bytes.
        signals: its signals.
        is_j1939: whether the database marks it as J1939 or ISO 11783: a parameter group of any node.
        maybe_j1939: whether it may be such a group in a database without marks.
    """

    name: str
    identifier: int
    extended: bool
    length: int
    signals: tuple[CanSignal, ...]
    is_j1939: bool
    maybe_j1939: bool


def read_databases(paths: Sequence[Path], source: Path) -> tuple[list[CanMessage], list[str]]:
    """Return the messages of the DBC files that belong to a log, each once, and notices on their errors."""
    if not paths:
        problem = (
            "a DBC file is required: put it in the log's folder or name it in campaign.toml, [can] databases"
        )
        raise LogError(source, problem)
    import_optional("cantools", "can", source)
    messages, notices = {}, []
    for path in paths:
        with as_log_errors(path, "a DBC file"):
            messages[path], notice = _parse(path.read_bytes())
        if not messages[path]:
            raise LogError(path, "contains no messages with signals; expected a DBC file of the bus")
        notices += [f"{path.name}: {notice}"] if notice else []
    return _with_distinct_names(messages), notices


def parameter_group(identifier: int) -> int:
    """Return the number of the J1939 parameter group of a 29-bit id, the destination address left out."""
    group = (identifier >> 8) & 0x3FFFF
    # A format below 240 is sent to one node, whose address is in the low byte.
    return group if (group >> 8) & 0xFF >= 240 else group & 0x3FF00


def node(identifier: int) -> int:
    """Return the source address in a 29-bit id of J1939."""
    return identifier & 0xFF


# A large database takes seconds, and every log of a campaign uses the same one.
@lru_cache(maxsize=8)
def _parse(content: bytes) -> tuple[tuple[CanMessage, ...], str]:
    from cantools.database import load_string
    from cantools.database.errors import Error

    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    notice = ""
    try:
        database = load_string(text, database_format="dbc")
    except Error as error:
        # Databases in use often hold signals that overlap; what fits its message can still be read.
        database = load_string(text, database_format="dbc", strict=False)
        notice = f"read with errors ({error}); signals that do not fit their message are left out"
    return tuple(_messages(database)), notice


def _messages(database: Any) -> Iterable[CanMessage]:
    attributes = database.dbc.attributes if database.dbc else {}
    marks_frame_format = bool(database.dbc) and "VFrameFormat" in database.dbc.attribute_definitions
    protocol = str(attributes["ProtocolType"].value) if "ProtocolType" in attributes else ""
    j1939 = protocol.replace(" ", "").upper().startswith(("J1939", "ISO11783"))
    for message in database.messages:
        extended = bool(message.is_extended_frame)
        unmarked = extended and not marks_frame_format
        is_j1939 = extended and (message.protocol == "j1939" or (unmarked and j1939))
        can_signals = [
            CanSignal(
                name=signal.name,
                unit=unit_text(signal.unit),
                start=signal.start,
                length=signal.length,
                little_endian=signal.byte_order == "little_endian",
                signed=bool(signal.is_signed),
                is_float=bool(signal.conversion.is_float),
                scale=float(signal.conversion.scale),
                offset=float(signal.conversion.offset),
                multiplexer=signal.multiplexer_signal,
                multiplexer_values=tuple(signal.multiplexer_ids or ()),
            )
            for signal in message.signals
            if 0 < signal.length <= MAX_SIGNAL_BITS
        ]
        yield CanMessage(
            name=message.name,
            identifier=message.frame_id,
            extended=extended,
            length=message.length,
            signals=tuple(s for s in can_signals if s.bit_positions.max() < 8 * message.length),
            is_j1939=is_j1939,
            maybe_j1939=unmarked and not is_j1939 and node(message.frame_id) == NULL_ADDRESS,
        )


def _with_distinct_names(messages_by_path: dict[Path, tuple[CanMessage, ...]]) -> list[CanMessage]:
    """Put the database's name before messages that share a name and differ."""
    distinct: dict[CanMessage, Path] = {}
    for path, messages in messages_by_path.items():
        for message in messages:
            distinct.setdefault(message, path)
    count = Counter(message.name for message in distinct)
    renamed = {
        original._replace(name=f"{path.stem}.{original.name}") if count[original.name] > 1 else original: path
        for original, path in distinct.items()
    }
    taken_names: set[str] = set()
    for renamed_message, path in renamed.items():
        # Two databases of one file name: no prefix can tell them apart.
        if renamed_message.name in taken_names:
            raise LogError(path, f"several messages are named '{renamed_message.name}'; names must differ")
        taken_names.add(renamed_message.name)
    return list(renamed)
