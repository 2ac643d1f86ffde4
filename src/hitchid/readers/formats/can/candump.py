"""Logs of candump, of the SocketCAN utilities: its log file and what it prints with absolute times."""

import re
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

from hitchid.readers.formats.can.streams import Frame

LONGEST_LINE = 400  # characters; printed with their text, 64 bytes take 310
HEAD_LINES = 20  # lines among which a log has its first frame (chosen)
ERROR_FRAME = 0x20000000  # flag in the id; linux/can.h
LINE = re.compile(
    r"\s*\((?P<stamp>\d+\.\d+)\)\s+(?P<bus>\S+)\s+(?:[RT]X\b.*?\s)?(?P<id>[0-9A-Fa-f]{3,8})"
    r"(?:#(?:#[0-9A-Fa-f])?(?:R\d?|(?P<packed>(?:[0-9A-Fa-f]{2}\.?)*))(?:\s+[RT])?"
    r"|\s+\[\d+\]\s+(?:remote request|(?P<spaced>[0-9A-Fa-f]{2}(?:\s+[0-9A-Fa-f]{2})*)?(?:\s+'.*')?))\s*"
)


def is_candump(path: Path) -> bool:
    """Return whether one of the first lines of a file is a frame as candump writes it."""
    with path.open(encoding="latin-1") as stream:
        return any(
            LINE.fullmatch(line)
            for line in islice(iter(lambda: stream.readline(LONGEST_LINE), ""), HEAD_LINES)
        )


def candump_frames(lines: Iterable[str], notices: list[str]) -> Iterator[Frame]:
    """Yield the frames of a log.

    Args:
        lines: of the log, each with its line end.
        notices: gets a message on lines that are no frames, such as a cut one.
    """
    others: list[int] = []
    for number, line in enumerate(lines, start=1):
        match = LINE.fullmatch(line)
        # A cut frame may look complete: its last bytes may be missing.
        if match is None or not line.endswith("\n"):
            others += [number] if line.strip() else []
            continue
        identifier, bus = int(match["id"], 16), re.search(r"\d+$", match["bus"])
        text = match["packed"] if match["packed"] is not None else match["spaced"]
        is_data = text is not None and not identifier & ERROR_FRAME
        data = bytes.fromhex(text.replace(".", "")) if is_data and text else b"" if is_data else None
        yield Frame(float(match["stamp"]), int(bus[0]) if bus else 0, identifier, len(match["id"]) > 3, data)
    if others:
        notices.append(
            f"left out: {len(others)} lines that are no complete frames, the first is line {others[0]}"
        )
