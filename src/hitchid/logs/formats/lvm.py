"""LabVIEW measurement files: text with a header before each segment of samples."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel, match_channels
from hitchid.logs.formats.columns import Columns
from hitchid.logs.formats.library import unique_names

SIGNATURE, HEADER_END, SEGMENT = "LabVIEW Measurement", "***End_of_Header***", "Channels"
X, COMMENT = "X_Value", "Comment"  # names of the columns of times and of notes
BLOCK_ROWS = 50_000  # rows parsed at once (chosen)
Header = Mapping[str, Sequence[str]]  # key to its value for each channel


def is_lvm(head: str) -> bool:
    """Return whether a text begins as a LabVIEW measurement file."""
    return head.startswith(SIGNATURE)


class _Segment(NamedTuple):
    """Rows of one segment, at most BLOCK_ROWS of them, with its header and the line of each row."""

    header: Header
    names: list[str]
    first_row: int
    lines: list[int]
    rows: list[list[str]]


def read(path: Path, blocks: Iterable[str], selection: ChannelSelection) -> Content:
    """Read the selected channels of a LabVIEW measurement file.

    The time is the column `X_Value` before a channel, else that of the first; without samples in it, time is
    counted from X0 in steps of Delta_X. Segments follow each other; where their times overlap, they start at
    the date and time of their headers.
    """
    columns, names, units = None, [], {}
    starts: list[tuple[int, float]] = []  # first line and start, s, of each segment
    for segment in _segments(blocks):
        sign = "," if segment.header.get("Decimal_Separator") == [","] else "."
        if columns is None:
            names = unique_names(segment.names)
            columns = Columns(path, names, strict=False, header=segment.lines[0] - 1, sign=sign)
            channels = [name for name in segment.names if name not in (X, COMMENT)]
            units = dict(zip(channels, segment.header.get("Y_Unit_Label", ()), strict=False))
        elif unique_names(segment.names) != names:
            problem = f"a segment has other channels; expected {', '.join(names)}"
            raise LogError(path, problem, line=segment.lines[0] - 1)
        # A segment longer than a block comes in several parts, and starts once.
        if segment.first_row == 0:
            starts.append((segment.lines[0], _start_s(segment.header)))
        columns.add(segment.lines, _cells(segment, len(names), sign))
    if columns is None:
        raise LogError(path, "there are no samples below the header line; expected a LabVIEW measurement")
    content = columns.content(units)
    clocks = _clocks(
        content, [name for name in content.channels if re.fullmatch(rf"{X}( \(\d+\))?", name)], starts
    )
    clock: np.ndarray | None = None
    clocked = {}
    for name in names:
        # An X column counts for the channels behind it, up to the next one.
        clock = clocks.get(name, clock)
        if name in content.channels:
            unit = "s" if name in clocks else content.channels[name].unit
            clocked[name] = LogChannel(clocks.get(name, content.channels[name].values), unit, clock)
    matches = match_channels(path, list(clocked), selection, has_clocks=clock is not None)
    return replace(content, channels={requested: clocked[name] for requested, name in matches.items()})


def _segments(blocks: Iterable[str]) -> Iterator[_Segment]:
    file_header: dict[str, list[str]] = {}
    header, names, count, lines, rows = dict(file_header), [], 0, [], []
    separator, in_header, number = "\t", True, 0
    for line in (line for block in blocks for line in block.removesuffix("\n").split("\n")):
        number += 1
        if line.startswith("Separator,"):
            separator = ","
        cells = [cell.strip() for cell in line.split(separator)]
        if not any(cells):
            continue
        if cells[0] == SEGMENT or len(rows) == BLOCK_ROWS:
            if rows:
                yield _Segment(header, names, count, lines, rows)
            count, lines, rows = count + len(rows), [], []
        if cells[0] == SEGMENT:
            header, names, count, in_header = dict(file_header), [], 0, True
        if in_header:
            header[cells[0]] = [cell for cell in cells[1:] if cell]
            if cells[0] == HEADER_END:
                in_header, file_header = False, file_header or header
        elif not names:
            names = cells
        else:
            lines.append(number)
            rows.append(cells)
    if rows:
        yield _Segment(header, names, count, lines, rows)


def _cells(segment: _Segment, width: int, sign: str) -> list[list[str]]:
    """Return the cells of each column, with the times that the header gives instead of samples."""
    columns = [[row[k] if k < len(row) else "" for row in segment.rows] for k in range(width)]
    start, step = (segment.header.get(key, [""])[0].replace(",", ".") for key in ("X0", "Delta_X"))
    # With no X column LabVIEW writes its header and leaves the cells empty.
    for k, name in enumerate(segment.names):
        if name == X and not any(columns[k]) and start and step:
            times = float(start) + float(step) * (segment.first_row + np.arange(len(segment.rows)))
            columns[k] = [repr(time).replace(".", sign) for time in times.tolist()]
    return columns


def _start_s(header: Header) -> float:
    """Return the date and time of a segment, s from a fixed origin; NaN if it has none."""
    date, time = (header.get(key, [""])[0] for key in ("Date", "Time"))
    match = re.fullmatch(r"(\d{4})/(\d\d)/(\d\d) (\d\d):(\d\d):(\d\d)(?:[.,](\d+))?", f"{date} {time}")
    if match is None:
        return np.nan
    stamp = datetime(*map(int, match.groups()[:6]), tzinfo=UTC)  # any zone: differences count
    return stamp.timestamp() + float(f"0.{match[7] or 0}")


def _clocks(
    content: Content, names: Sequence[str], starts: Sequence[tuple[int, float]]
) -> dict[str, np.ndarray]:
    """Return the times of each X column, s, one segment after the other."""
    clocks = {name: content.channels[name].values for name in names}
    # Times that go on from segment to segment need no dates.
    if len(starts) == 1 or not any(np.any(np.diff(clock) <= 0) for clock in clocks.values()):
        return clocks
    rows = next(iter(clocks.values())).size
    segments = np.searchsorted(
        [line for line, _ in starts], [content.line_of(row) or 0 for row in range(rows)], "right"
    )
    offsets = np.array([start_s - starts[0][1] for _, start_s in starts])[segments - 1]
    return {name: clock + offsets for name, clock in clocks.items()}
