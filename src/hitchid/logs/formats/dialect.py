"""Detection of the dialect of a text log from its beginning: separator, header, units."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import islice, pairwise
from pathlib import Path
from typing import NamedTuple

from hitchid.errors import LogError
from hitchid.logs.formats.numerals import is_number
from hitchid.logs.units import parse_unit

# The label rows above the samples in text exported by dSPACE ControlDesk.

# First cells of the label rows.
NAMES, UNITS, RASTERS, PATHS, SAMPLES = "trace_names", "trace_units", "raster", "path", "trace_values"
TIME = "time_s"  # name given to the time, which has none in the file


def labelled_dialect(separator: str, rows: Sequence[tuple[int, Sequence[str]]]) -> "Dialect | None":
    """Return the dialect that the label rows give, None for a text without them.

    A name that occurs twice is replaced by the last part of its path. The time is named `time_s`, and
    `time_s/` with the raster if there is a time for each of several rasters.
    """
    labelled = {cells[0]: (line, cells) for line, cells in rows if cells and cells[0]}
    if NAMES not in labelled or SAMPLES not in labelled:
        return None
    header, first = labelled[NAMES][0], labelled[SAMPLES][0]
    width = len(labelled[SAMPLES][1])

    def cells(label: str) -> list[str]:
        row = labelled[label][1] if label in labelled else ()
        return [*row, *[""] * width][:width]

    column_names = cells(NAMES)
    count = Counter(column_names[1:])
    names = [""]
    for name, path, raster in list(zip(column_names, cells(PATHS), cells(RASTERS), strict=True))[1:]:
        if name:
            names.append(path.rpartition("/")[2] or name if count[name] > 1 else name)
        else:
            names.append(TIME if count[""] == 1 else f"{TIME}/{raster}")
    units = {name: "s" for name in names if name.startswith(TIME)}
    units |= {name: unit for name, unit in zip(names, cells(UNITS), strict=True) if name and unit}
    return Dialect(separator, tuple(names), units, header, first)


SEPARATORS = ("\t", ";", "|", ",", " ")
LINES, HEADER_ROWS = 200, 10  # lines that decide the dialect; rows above the samples that may be the header
LONGEST_SHOWN, LONGEST_NAME = 60, 200  # characters: in a message; of a column's name
WIDE_START = 8  # bytes that tell UTF-16; chosen
NOT_TEXT = 0.3  # share of suspect characters above which a file is not text; chosen
NO_UNIT_TEXT = ("1", "-")  # units of a ratio that may also be a sample or a missing value
UNIT_LABELS = ("unit", "units", "einheit", "einheiten")
BRACKETS = re.compile(r"(.+?)\s*[\[(]([^\[\]()]*)[\])]")
COMMENT_MARK = re.compile(r"^[#%]+\s*(?=\w)")
ZEROS = re.compile(rb"\0+")
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class _Row(NamedTuple):
    line: int
    cells: list[str]


class Dialect(NamedTuple):
    """The dialect of a text log.

    Attributes:
        separator: between columns; a space means any run of white space.
        names: of the columns, in order.
        units: name to unit, from a row of units or from brackets behind the name.
        header: line of the names, from 1.
        first: line of the first sample, from 1; the line after the last if there is none.
    """

    separator: str
    names: tuple[str, ...]
    units: dict[str, str]
    header: int
    first: int

    def column_indices(self, requested: str) -> list[int]:
        """Return the columns of that name, else those of that name with a unit in brackets."""
        exact = [index for index, name in enumerate(self.names) if name == requested]
        return exact or [index for index, name in enumerate(self.names) if _without_unit(name) == requested]


def encoding_of(head: bytes, source: Path) -> str:
    """Return the encoding of a text from its first bytes."""
    for mark, encoding in BYTE_ORDER_MARKS.items():
        if head.startswith(mark):
            return encoding
    # Text in UTF-16 without a mark has a zero byte in each of its first characters.
    start = head[:WIDE_START]
    if len(start) == WIDE_START and any(start[k::2].count(0) == WIDE_START // 2 for k in (0, 1)):
        return "utf-16-le" if start[1] == 0 else "utf-16-be"
    # What lost power wrote says nothing about the rest.
    text = ZEROS.sub(b"\0", head[: head.rfind(b"\n") + 1] or head)
    try:
        text.decode()
        encoding, readable = "utf-8", True
    except UnicodeDecodeError:
        encoding, readable = "cp1252", not CONTROL.search(text)
    suspect_count = (
        sum(byte > 127 for byte in text[:4096]) if encoding == "cp1252" else len(CONTROL.findall(text[:4096]))
    )
    if not readable or suspect_count > NOT_TEXT * len(text[:4096]):
        raise LogError(source, "is not text in UTF-8, UTF-16 or Latin-1; expected a CSV log")
    return encoding


def dialect_of(text: str, source: Path, requested: Sequence[str] = ()) -> Dialect:
    """Return the dialect of a log from its first lines.

    The separator is the one that yields most numbers or stamps. The header is one of the ten lines above the
    first two lines of numbers: the one with most of the requested names, else of the samples' width.
    """
    first_line = next((line for line in text.split("\n") if line.strip()), "").strip()
    if not first_line:
        raise LogError(source, "the file is empty; expected a header line and samples")
    rows_by_separator = {separator: _rows(text, separator) for separator in SEPARATORS}
    counts = {
        candidate: sum(sum(map(is_number, row.cells)) for row in rows if len(row.cells) > 1)
        for candidate, rows in rows_by_separator.items()
    }
    # Commas and spaces stand within numbers and stamps, too: other separators need half of their numbers.
    separator = max(SEPARATORS, key=lambda sign: counts[sign] * (1 if sign in ", " else 2))
    # A header without samples: the separator that splits it most is right; the comma, if none does.
    if not counts[separator]:
        separator = max((",", *SEPARATORS), key=lambda candidate: len(rows_by_separator[candidate][0].cells))
    rows = rows_by_separator[separator]
    labelled = labelled_dialect(separator, rows)
    if labelled is not None:
        return labelled
    first_data_row = _first_sample(rows)
    header_rows = _header_rows(rows[:1] if first_data_row is None else rows[:first_data_row])
    if not header_rows:
        first_requested = requested[0] if requested else None
        problem = f"there is no header line with names, found '{first_line[:LONGEST_SHOWN]}'"
        raise LogError(source, problem, line=rows[0].line, column=first_requested)
    width = len(rows[first_data_row].cells) if first_data_row is not None else 0
    header, names = max(
        # Of equal rows the last: names stand directly above the samples.
        reversed([row for row in header_rows if not _is_unit_row(row.cells)] or header_rows),
        key=lambda row: (
            sum(cell in requested or _without_unit(cell) in requested for cell in row.cells),
            len(row.cells) == width,
            len({cell for cell in row.cells if cell}),
        ),
    )
    rows_below = [row for row in rows if row.line > header]
    samples = [
        row for row in rows_below if first_data_row is not None and row.line >= rows[first_data_row].line
    ]
    # A row of numbers above a bad line is a sample, too; the bad line is then an error.
    first = next((row.line for row in rows_below if _is_sample(row.cells)), header + 1)
    check_width(source, separator, names, samples, header)
    unit_cells = next(
        (row.cells for row in header_rows if row.cells is not names and _is_unit_row(row.cells)), ()
    )
    units = {name: unit for name, unit in zip(names, unit_cells, strict=False) if unit and name}
    for name in names:
        bracketed = BRACKETS.fullmatch(name[: LONGEST_NAME + 1])
        if bracketed:
            units.setdefault(name, bracketed.group(2).strip())
    return Dialect(separator, tuple(names), units, header, first)


def has_samples(text: str) -> bool:
    """Return whether two successive lines of a text are rows of as many cells, most of them numbers."""
    return any(
        len(one.cells) == len(other.cells) > 1
        and all(2 * sum(map(is_number, row.cells)) > len(row.cells) for row in (one, other))
        for separator in SEPARATORS
        for one, other in pairwise(_rows(text, separator))
    )


def check_width(
    source: Path,
    separator: str,
    names: Sequence[str],
    samples: Iterable[tuple[int, Sequence[str]]],
    header: int,
) -> None:
    """Refuse rows with more or fewer cells than names: they would be assigned to the wrong columns."""
    for line, cells in samples:
        width = max((column for column, cell in enumerate(cells, start=1) if cell), default=0)
        if width > len(names) or (separator == " " and len(cells) < len(names)):
            problem = f"the line has {len(cells)} cells, the header in line {header} {len(names)} names"
            raise LogError(source, f"{problem}; expected one name per cell", line=line)


def _without_unit(name: str) -> str:
    """Return a name without the unit in brackets behind it; too long a name is returned unchanged."""
    return BRACKETS.sub(r"\1", name) if len(name) <= LONGEST_NAME else name


def _rows(text: str, separator: str) -> list[_Row]:
    """Return the first rows that are not blank, each with its line number; cells may be quoted."""
    rows: list[_Row] = []
    lines = io.StringIO(text)
    if separator == " ":
        split = ((number, line.split()) for number, line in enumerate(lines, start=1))
        return [_Row(number, cells) for number, cells in islice(split, LINES) if cells]
    reader = csv.reader(lines, delimiter=separator)
    line = 1
    with suppress(csv.Error):  # a cell above the size limit; the rows before it suffice
        for cells in islice(reader, LINES):
            stripped = [cell.strip() for cell in cells]
            if any(stripped):
                rows.append(_Row(line, stripped))
            line = reader.line_num + 1
    return rows or [_Row(1, [text[:LONGEST_SHOWN]])]


def _first_sample(rows: Sequence[_Row]) -> int | None:
    """Return the index of the first of two successive rows of numbers, or of the only one, or None."""
    is_sample = [_is_sample(row.cells) for row in rows]
    is_first_of_two = [one and other for one, other in zip(is_sample, [*is_sample[1:], True], strict=True)]
    flags = is_first_of_two if True in is_first_of_two else is_sample
    return flags.index(True) if True in flags else None


def _is_sample(cells: Sequence[str]) -> bool:
    """Return whether most cells, or the first of several, are numbers; a row of units is not a sample."""
    numbers = sum(map(is_number, cells))
    return len(cells) > 1 and (2 * numbers > len(cells) or is_number(cells[0])) and not _is_unit_row(cells)


def _header_rows(rows_above: Sequence[_Row]) -> list[_Row]:
    """Return the rows above the samples that may be names or units."""
    rows: list[_Row] = []
    for line, cells in rows_above[: -HEADER_ROWS - 1 : -1]:
        # A preamble has fewer cells than the header: what stands above it belongs to it.
        if rows and len(cells) < len(rows[0].cells):
            break
        rows.append(_Row(line, [COMMENT_MARK.sub("", cells[0]), *cells[1:]]))
    # Of a header that is repeated below the first sample, the first counts.
    first_by_cells = {tuple(row.cells): row for row in rows}
    return sorted(first_by_cells.values())


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether at least half of the filled cells of a row, without a label in front, are units."""
    stripped = [cell.strip("[]() ") for cell in cells]
    body = stripped[1:] if stripped and stripped[0].lower() in UNIT_LABELS else stripped
    filled = [cell for cell in body if cell]
    # A row of samples may hold a cell that looks like a unit, but 1 alone is the unit of a ratio.
    if any(map(is_number, set(filled) - {"1"})):
        return False
    unit_cells = [cell for cell in filled if parse_unit(cell)]
    return any(cell not in NO_UNIT_TEXT for cell in unit_cells) and 2 * len(unit_cells) >= len(filled)
