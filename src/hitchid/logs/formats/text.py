"""Text logs, one line a sample, in any dialect: separator, decimal sign, header, units."""

import codecs
import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, compress
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.inert import spreadsheet_text
from hitchid._support.numbers import count
from hitchid.errors import LogError
from hitchid.logs.content import ALWAYS_ALLOWED_BYTES, ChannelSelection, Content, no_such_channel
from hitchid.logs.formats import lvm
from hitchid.logs.formats.columns import Columns
from hitchid.logs.formats.dialect import ZEROS, Dialect, check_width, dialect_of, encoding_of, has_samples
from hitchid.logs.formats.numerals import NUMBER, Numerals

SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".lvm")
SHARED_SUFFIXES = (".txt", ".txt.gz", ".dat", ".dat.gz")  # of notes and binary files, too
HEAD, BLOCK = 2**22, 2**22  # bytes: beginning that decides the dialect; part parsed at once
TABLE_HEAD = 2**16  # bytes in which a text has a first row of numbers (chosen)
# Characters of the longest line, ten of which are in the head: a sample of ten thousand channels; chosen.
LONGEST_LINE = 2**18
MAX_TEXT_RATIO = 50  # unpacked bytes a packed one; text logs have 5 to 20 (chosen)
LAST_ROWS = 100  # rows with which one without a line end is compared (chosen)
NO_FINAL_NEWLINE = "the final newline is missing: the last line may be truncated"


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected columns of a text log, block by block; other columns may hold text.

    Time stamps in text become seconds since the first, missing values NaN. Lines without a sample, such as
    comments, are left out.
    """
    blocks = _blocks(path)
    head = next(blocks, "")
    if lvm.is_lvm(head):
        return lvm.read(path, chain([head], blocks), selection)
    requested = (
        () if selection.signals is None else tuple(dict.fromkeys((selection.time, *selection.signals)))
    )
    dialect = dialect_of(head, path, requested)
    # If all columns are selected, those with a name that occurs twice are left out.
    names = requested or tuple(name for name, times in Counter(dialect.names).items() if name and times == 1)
    indices = [_column_index(path, dialect, name) for name in names]
    columns = Columns(path, names, strict=bool(requested), header=dialect.header)
    # A full disk or lost power leaves zero bytes: they are counted, not refused, since the rest is good.
    zero_lines: list[int] = []
    others: list[list[str]] = []
    for first, block in _blocks_from_line(chain([head], blocks), dialect.first):
        lines, rows = _rows(path, dialect, first, block, zero_lines)
        if rows and not block.endswith("\n"):
            columns.notices.append(_end_notice(dialect, [*others, *rows], lines[-1]))
            rows = rows[: -1 if columns.notices[-1] != NO_FINAL_NEWLINE else None]
        if not rows:
            continue
        # Kept for the last block, which may hold a single row: others show how long its numbers are.
        others = rows[-LAST_ROWS:]
        if len(max(rows, key=len)) > len(dialect.names) or dialect.separator == " ":
            check_width(
                path, dialect.separator, dialect.names, zip(lines, rows, strict=False), dialect.header
            )
        columns.add(lines[: len(rows)], [_cells(rows, index) for index in indices])
    if zero_lines:
        columns.notices.append(
            f"left out: {count(len(zero_lines), 'line')} with zero bytes, the first is line {zero_lines[0]}: "
            "the disk was full, or the logger lost its power"
        )
    return columns.content(
        {name: dialect.units.get(dialect.names[index]) for name, index in zip(names, indices, strict=True)}
    )


def is_table(path: Path) -> bool:
    """Return whether a file begins like a text log, with rows of numbers near its beginning."""
    try:
        with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as file:
            head = file.read(TABLE_HEAD)
        text = head.decode(encoding_of(head, path), errors="replace")
    except (LogError, EOFError, zlib.error):
        return False
    return lvm.is_lvm(text) or has_samples(text.replace("\r", "\n"))


def _rows(
    path: Path, dialect: Dialect, first: int, block: str, zero_lines: list[int]
) -> tuple[Sequence[int], list[list[str]]]:
    """Return the lines that are not blank, from line `first` on, and their cells, which may be quoted."""
    is_quoted = '"' in block and dialect.separator != " "
    lines: Sequence[int] = []
    if dialect.separator == " ":
        rows = [line.split() for line in block.removesuffix("\n").split("\n")]
    else:
        quoting = csv.QUOTE_MINIMAL if is_quoted else csv.QUOTE_NONE
        reader = csv.reader(io.StringIO(block), delimiter=dialect.separator, quoting=quoting)
        try:
            if is_quoted:  # a cell may hold line ends
                numbered = [(first + reader.line_num - 1, row) for row in reader]
                lines, rows = [line for line, _ in numbered], [row for _, row in numbered]
            else:
                rows = list(reader)
        except csv.Error as error:
            line = first + reader.line_num - 1
            raise LogError(path, f"cannot be parsed: {error}", line=line) from error
    lines = lines or range(first, first + len(rows))
    # Only then can a row be blank: most blocks need no second look at their cells.
    if min(map(len, rows)) < 2:
        kept = [k for k, row in enumerate(rows) if any(map(str.strip, row))]
        lines, rows = [lines[k] for k in kept], [rows[k] for k in kept]
    if "\0" in block:
        # A row next to zero bytes may be cut within a number.
        cut = [any("\0" in cell for cell in row) for row in rows]
        zero_lines += compress(lines, cut)
        kept = [k for k, is_cut in enumerate(cut) if not is_cut]
        lines, rows = [lines[k] for k in kept], [rows[k] for k in kept]
    return lines, rows


def _cells(rows: Sequence[Sequence[str]], index: int) -> list[str]:
    """Return the cells of a column, empty where a row ends before it."""
    try:
        return list(map(itemgetter(index), rows))
    except IndexError:
        return [row[index] if index < len(row) else "" for row in rows]


def _end_notice(dialect: Dialect, rows: list[list[str]], line: int) -> str:
    """Return the notice on a last row without a line end, NO_FINAL_NEWLINE if it seems whole.

    It is cut if cells are missing, or digits behind the decimal sign that all other rows have.
    """
    last, others = rows[-1], rows[:-1]
    column = len(last) - 1
    decimals = min((_decimals(row[column]) for row in others if len(row) > column), default=0)
    width = min(map(len, others), default=len(dialect.names))
    if len(last) >= width and (not decimals or _decimals(last[column]) >= decimals):
        return NO_FINAL_NEWLINE
    return f"the last line, {line}, is left out: it is cut"


def _decimals(cell: str) -> int:
    return len(re.split("[.,]", cell.strip(), maxsplit=1)[-1]) if re.search("[.,]", cell) else 0


class TextRows(NamedTuple):
    """Header and rows of a text log as text, and the line of each row in the file."""

    header: list[str]
    rows: list[list[str]]
    lines: list[int]


def read_rows(path: Path) -> TextRows:
    """Return header and rows of a text log as text; every row has as many cells as the header.

    A decimal comma becomes a point.
    """
    blocks = _blocks(path)
    head = next(blocks, "")
    dialect = dialect_of(head, path)
    width, lines, rows = len(dialect.names), [], []
    for first, block in _blocks_from_line(chain([head], blocks), dialect.first):
        block_lines, block_rows = _rows(path, dialect, first, block, [])
        lines += block_lines
        rows += [row[:width] + [""] * (width - len(row)) for row in block_rows]
    numerals = Numerals()
    numerals.examine({"": "\n".join(chain.from_iterable(rows))})
    if numerals.sign == ",":
        rows = [
            [cell.replace(",", ".") if NUMBER.fullmatch(cell.strip()) else cell for cell in row]
            for row in rows
        ]
    return TextRows(list(dialect.names), rows, lines)


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as a CSV log, gzip-compressed where the name ends in `.gz`.

    Numbers are written with the fewest digits that read back as the same number.
    """
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    write_rows(path, list(columns), [[repr(value) for value in row] for row in rows])


def write_rows(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a header and rows of text as a CSV log, gzip-compressed where the name ends in `.gz`."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([spreadsheet_text(cell) for cell in row] for row in (header, *rows))
    data = text.getvalue().encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix.lower() == ".gz" else data)


def _column_index(path: Path, dialect: Dialect, name: str) -> int:
    indices = dialect.column_indices(name)
    if len(indices) > 1:
        candidates = ", ".join(dialect.names[index] for index in indices)
        raise LogError(path, f"the name is ambiguous: {candidates}", line=dialect.header, column=name)
    if not indices:
        names = [other for other in dialect.names if other]
        raise no_such_channel(path, name, names, kind="column", line=dialect.header)
    return indices[0]


def _blocks_from_line(blocks: Iterable[str], first: int) -> Iterator[tuple[int, str]]:
    """Yield the text from line `first` on, block by block, each with the number of its first line."""
    line = 1
    for block in blocks:
        lines = block.count("\n") + (not block.endswith("\n"))
        skipped = min(max(first - line, 0), lines)
        remaining = block if not skipped else block.split("\n", skipped)[-1] if skipped < lines else ""
        if remaining.strip():
            yield line + skipped, remaining
        line += lines


def _blocks(path: Path) -> Iterator[str]:
    """Return the text of a plain or gzip-compressed log in blocks of whole lines."""
    rest, first = "", 1
    try:
        if path.suffix.lower() == ".gz":
            # Before anything is parsed: a few packed bytes may hold more rows than the memory.
            max_bytes, size = max(ALWAYS_ALLOWED_BYTES, MAX_TEXT_RATIO * path.stat().st_size), 0
            with gzip.open(path) as file:
                for chunk in iter(partial(file.read, BLOCK), b""):
                    size += len(chunk)
                    if size > max_bytes:
                        problem = f"unpacks to more than {MAX_TEXT_RATIO} times its size; check the file"
                        raise LogError(path, problem)
        for chunk in _decode_text(path):
            text = rest + chunk
            for line, length in enumerate(map(len, text.split("\n")), start=first):
                if length > LONGEST_LINE:
                    problem = (
                        f"is longer than {LONGEST_LINE} characters; expected a text log, one line a sample"
                    )
                    raise LogError(path, problem, line=line)
            complete, newline, rest = text.rpartition("\n")
            if newline:
                first += complete.count("\n") + 1
                yield complete + newline
    except UnicodeDecodeError as error:
        raise LogError(path, f"is not text in its encoding: {error}") from error
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(path, f"cannot be read: {error}") from error
    # What follows the last line end is a block of its own: it may be cut, and is judged as such.
    if rest:
        yield rest


def _decode_text(path: Path) -> Iterator[str]:
    """Yield the text in parts, every line end as a line feed and every run of zero bytes as one."""
    is_gzip = path.suffix.lower() == ".gz"
    with gzip.open(path) if is_gzip else path.open("rb") as file:
        head = file.read(HEAD)
        encoding = encoding_of(head, path)
        is_wide = encoding.startswith("utf-16")
        text_decoder = codecs.getincrementaldecoder(encoding)("strict" if is_wide else "replace")
        # Carriage returns in front of line feeds or without them end a line, too.
        decoder = io.IncrementalNewlineDecoder(text_decoder, translate=True)
        for chunk in chain([head], iter(partial(file.read, BLOCK), b"")):
            has_zeros = not is_wide and b"\0\0" in chunk
            yield decoder.decode(ZEROS.sub(b"\0", chunk) if has_zeros else chunk)
        yield decoder.decode(b"", final=True)
