"""Detection of the dialect of a text log from its beginning: separator, decimal sign, header, units."""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from hitchid.data.units import parse_unit
from hitchid.errors import LogError
from hitchid.readers.formats.controldesk import labels_of

SEPARATORS = ("\t", ";", "|", ",", " ")
LINES, HEADER_ROWS = 200, 10  # lines that decide the dialect; rows above the samples that may be the header
LONGEST_SHOWN, LONGEST_NAME = 60, 200  # characters: in a message; of a column's name
NOT_TEXT = 0.3  # share of suspect characters above which a file is not text; chosen
NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
UNIT_LABELS = ("unit", "units", "einheit", "einheiten")
BRACKETS = re.compile(r"(.+?)\s*[\[(]([^\[\]()]*)[\])]")
CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class _Row(NamedTuple):
    line: int
    cells: list[str]


class Dialect(NamedTuple):
    """The dialect of a text log.

    Attributes:
        separator: between columns; a space means any run of white space.
        comma: whether the decimal sign is a comma.
        names: of the columns, in order.
        units: name to unit, from a row of units or from brackets behind the name.
        header: line of the names, from 1.
        first: line of the first sample, from 1; the line after the last if there is none.
    """

    separator: str
    comma: bool
    names: tuple[str, ...]
    units: dict[str, str]
    header: int
    first: int

    def column_indices(self, requested: str) -> list[int]:
        """Return the columns of that name, else those of that name with a unit in brackets."""
        exact = [index for index, name in enumerate(self.names) if name == requested]
        return exact or [index for index, name in enumerate(self.names) if _without_unit(name) == requested]


def encoding_of(head: bytes, source: Path) -> str:
    """Return the encoding of a text from its first bytes.

    Raises:
        LogError: the bytes are not text.
    """
    for mark, encoding in BYTE_ORDER_MARKS.items():
        if head.startswith(mark):
            return encoding
    text = head[: head.rfind(b"\n") + 1] or head
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

    The separator is the one that yields most numbers. The header is one of the ten lines above the first two
    lines of numbers: the one with most of the requested names.

    Args:
        text: the beginning of the log.
        source: its file, for messages.
        requested: names of columns.

    Raises:
        LogError: the log is empty, or has no header line.
    """
    first_line = next((line for line in text.split("\n") if line.strip()), "").strip()
    if not first_line:
        raise LogError(source, "the file is empty; expected a header line and samples")
    rows_by_separator = {separator: _rows(text, separator) for separator in SEPARATORS}
    separator = max(SEPARATORS, key=lambda candidate: _count_numbers(rows_by_separator[candidate]))
    if not _count_numbers(rows_by_separator[separator]):
        separator = max((",", *SEPARATORS), key=lambda candidate: len(rows_by_separator[candidate][0].cells))
    rows = rows_by_separator[separator]
    labels = labels_of(rows)
    if labels is not None:
        comma = separator != "," and _has_decimal_comma(text, separator)
        return Dialect(separator, comma, *labels)
    first_data_row = _first_sample(rows)
    header_rows = _header_rows(rows[:1] if first_data_row is None else rows[:first_data_row])
    if not header_rows:
        first_requested = requested[0] if requested else None
        problem = f"there is no header line with names, found '{first_line[:LONGEST_SHOWN]}'"
        raise LogError(source, problem, line=rows[0].line, column=first_requested)
    header, names = max(
        reversed([row for row in header_rows if not _is_unit_row(row.cells)] or header_rows),
        key=lambda row: sum(cell in requested or _without_unit(cell) in requested for cell in row.cells),
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
    comma = separator != "," and _has_decimal_comma(text, separator)
    if comma:
        _check_thousands(source, samples)
    return Dialect(separator, comma, tuple(names), units, header, first)


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


def _check_thousands(source: Path, samples: Sequence[_Row]) -> None:
    """Refuse commas that may separate thousands: each precedes three digits, and some cells have none.

    12,345 among 1,234 and 999 may be a thousand; 0,345 or 12,5 anywhere proves that commas are decimal.
    """
    cells = [(column, cell) for row in samples for column, cell in enumerate(row.cells)]
    commas = [(column, cell) for column, cell in cells if "," in cell and _is_number(cell)]
    integer_columns = {column for column, cell in cells if cell.lstrip("+-").isdecimal()}
    mixed = [cell for column, cell in commas if column in integer_columns]
    if mixed and all(THOUSANDS.fullmatch(cell) for _, cell in commas):
        problem = (
            f"'{mixed[0]}' is ambiguous: a decimal comma or a thousands separator; use no thousands separator"
        )
        raise LogError(source, problem)


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


def _count_numbers(rows: Sequence[_Row]) -> int:
    """Return the count of cells that are numbers, in rows of two cells or more."""
    return sum(sum(map(_is_number, row.cells)) for row in rows if len(row.cells) > 1)


def _is_number(cell: str) -> bool:
    return NUMBER.fullmatch(cell) is not None


def _first_sample(rows: Sequence[_Row]) -> int | None:
    """Return the index of the first of two successive rows of numbers, or of the only one, or None."""
    is_sample = [_is_sample(row.cells) for row in rows]
    is_first_of_two = [one and other for one, other in zip(is_sample, [*is_sample[1:], True], strict=True)]
    flags = is_first_of_two if True in is_first_of_two else is_sample
    return flags.index(True) if True in flags else None


def _is_sample(cells: Sequence[str]) -> bool:
    """Return whether most cells, or the first of several, are numbers; a row of units is not a sample."""
    numbers = sum(map(_is_number, cells))
    return len(cells) > 1 and (2 * numbers > len(cells) or _is_number(cells[0])) and not _is_unit_row(cells)


def _header_rows(rows_above: Sequence[_Row]) -> list[_Row]:
    """Return the rows above the samples that may be names or units."""
    rows: list[_Row] = []
    for line, cells in rows_above[: -HEADER_ROWS - 1 : -1]:
        if rows and len(cells) < len(rows[0].cells):
            break
        rows.append(_Row(line, [cells[0].lstrip("#% "), *cells[1:]]))
    return rows[::-1]


def _is_unit_row(cells: Sequence[str]) -> bool:
    """Return whether at least half of the filled cells of a row, without a label in front, are units."""
    stripped = [cell.strip("[]() ") for cell in cells]
    body = stripped[1:] if stripped and stripped[0].lower() in UNIT_LABELS else stripped
    filled = [cell for cell in body if cell]
    if any(map(_is_number, set(filled) - {"1"})):
        return False
    unit_cells = [cell for cell in filled if parse_unit(cell)]
    has_unit_text = any(cell.isalpha() or not cell.isascii() for cell in unit_cells)
    return has_unit_text and 2 * len(unit_cells) >= len(filled)


def _has_decimal_comma(text: str, separator: str) -> bool:
    """Return whether some number in the text has a decimal comma."""
    # If white space is the separator, the padding must not match it too: the search in a long run of it would
    # take quadratic time.
    gap, pad = (r"\s", '"*') if separator == " " else (re.escape(separator), '[ "]*')
    comma_match = re.search(
        rf"(?:^|{gap}){pad}[+-]?\d*,\d+(?:[eE][+-]?\d+)?{pad}(?:{gap}|\r?$)", text, re.MULTILINE
    )
    return comma_match is not None
