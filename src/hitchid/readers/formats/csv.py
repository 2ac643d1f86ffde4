"""Text logs, one line a sample, in any dialect: separator, decimal sign, header, units."""

import codecs
import csv
import gzip
import io
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.inert import spreadsheet_text
from hitchid.data.content import Content, LogChannel
from hitchid.errors import LogError
from hitchid.readers.content import CHANNEL_HINT, MAX_UNPACK_RATIO, ChannelSelection, max_unpacked_bytes
from hitchid.readers.formats.dialect import Dialect, check_width, dialect_of, encoding_of

SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".lvm")
HEAD, BLOCK = 2**20, 2**25  # bytes: beginning that decides the dialect; part parsed at once
LONGEST_SHOWN = 40  # characters of a cell in a message
NO_FINAL_NEWLINE = "the final newline is missing: the last line may be truncated"


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected columns of a text log, block by block; other columns may hold text.

    Raises:
        LogError: the file cannot be read, a column is missing, or a cell is not a number; the message names
            line and column.
    """
    blocks = _blocks(path)
    head = next(blocks, "")
    requested = (
        () if selection.signals is None else tuple(dict.fromkeys((selection.time, *selection.signals)))
    )
    dialect = dialect_of(head[:HEAD], path, requested)
    # If all columns are selected, those with a name that occurs twice are left out.
    requested = requested or tuple(
        name for name, count in Counter(dialect.names).items() if name and count == 1
    )
    column_reader = _ColumnReader(
        path, dialect, requested, tuple(_column_index(path, dialect, name) for name in requested)
    )
    parsed_blocks, block = [], "\n"
    for line, block in _blocks_from_line(chain([head], blocks), dialect.first):
        parsed_blocks.append(column_reader.parse_block(line, block))
    if not parsed_blocks:
        raise LogError(path, "there are no samples below the header line", line=dialect.header)
    channels = {
        name: LogChannel(
            _join_column([parsed_block.columns for parsed_block in parsed_blocks]),
            dialect.units.get(dialect.names[index]),
        )
        for name, index in reversed(list(zip(requested, column_reader.indices, strict=True)))
    }
    lines = [(parsed_block.sample_count, parsed_block.lines) for parsed_block in parsed_blocks]
    ordered = {name: channels[name] for name in requested}
    notices = () if block.endswith("\n") else (NO_FINAL_NEWLINE,)
    return Content(path, ordered, notices, partial(_line_of, lines))


def _join_column(blocks: Sequence[list[np.ndarray]]) -> np.ndarray:
    """Remove the last column of all blocks and return it as one read-only array.

    This limits the memory for a long log: no more than one column exists twice.
    """
    column = np.concatenate([block.pop() for block in blocks])
    column.setflags(write=False)
    return column


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a text log as text; every row has as many cells as the header.

    A decimal comma becomes a point.
    """
    text = "".join(_blocks(path))
    dialect = dialect_of(text[:HEAD], path)
    lines = text.split("\n")[dialect.first - 1 :]
    try:
        if dialect.separator == " ":
            rows = [line.split() for line in lines if line.strip()]
        else:
            reader = csv.reader(io.StringIO("\n".join(lines)), delimiter=dialect.separator)
            rows = [row for row in reader if row]
    except csv.Error as error:
        raise LogError(path, f"cannot be parsed as comma-separated text: {error}") from error
    if dialect.comma:
        rows = [
            [_with_decimal_point(cell) if cell.strip(" +-0123456789eE") == "," else cell for cell in row]
            for row in rows
        ]
    width = len(dialect.names)
    return list(dialect.names), [row[:width] + [""] * (width - len(row)) for row in rows]


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of equal length as a CSV log, gzip-compressed where the name ends in `.gz`.

    Numbers are written with the fewest digits that read back as the same number.

    Raises:
        OSError: the file cannot be written.
    """
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    write_rows(path, list(columns), [[repr(value) for value in row] for row in rows])


def write_rows(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Write a header and rows of text as a CSV log, gzip-compressed where the name ends in `.gz`.

    Raises:
        OSError: the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([spreadsheet_text(cell) for cell in row] for row in (header, *rows))
    data = text.getvalue().encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix.lower() == ".gz" else data)


def _with_decimal_point(text: str) -> str:
    """Return text with decimal points for commas; points become `?`, which no number contains."""
    return text.replace(".", "?").replace(",", ".")


def _column_index(path: Path, dialect: Dialect, name: str) -> int:
    indices = dialect.column_indices(name)
    if len(indices) > 1:
        candidates = ", ".join(dialect.names[index] for index in indices)
        raise LogError(path, f"the name is ambiguous: {candidates}", line=dialect.header, column=name)
    if not indices:
        known_names = ", ".join(dialect.names)
        raise LogError(
            path,
            f"there is no such column; {CHANNEL_HINT}; found {known_names}",
            line=dialect.header,
            column=name,
        )
    return indices[0]


class _ParsedBlock(NamedTuple):
    """The samples of a block: how many, each column of shape [N], and the line of the first or of each."""

    sample_count: int
    columns: list[np.ndarray]
    lines: int | np.ndarray


class _ColumnReader(NamedTuple):
    """Parser of the selected columns: their names and indices."""

    path: Path
    dialect: Dialect
    names: tuple[str, ...]
    indices: tuple[int, ...]

    def parse_block(self, first: int, block: str) -> _ParsedBlock:
        """Return the numbers of a block whose first line is `first`."""
        self.check_width(first, block)
        separator = None if self.dialect.separator == " " else self.dialect.separator
        text = io.StringIO(_with_decimal_point(block) if self.dialect.comma else block)
        try:
            rows = np.loadtxt(
                text, delimiter=separator, usecols=self.indices, ndmin=2, comments=None, quotechar='"'
            )
        except ValueError:
            raise self.first_error(first, block) from None
        columns = [rows[:, index].copy() for index in range(len(self.indices))]
        return _ParsedBlock(len(rows), columns, _lines(block, first, len(rows)))

    def check_width(self, first: int, block: str) -> None:
        """Refuse rows that are wider than the header; blocks with too few separators are not parsed."""
        separator, names = self.dialect.separator, self.dialect.names
        if max(line.count(separator) for line in block.split("\n")) < len(names) or separator == " ":
            return
        reader = csv.reader(io.StringIO(block), delimiter=separator)
        rows = ((first + reader.line_num - 1, [cell.strip() for cell in row]) for row in reader)
        with suppress(csv.Error):  # such a row is refused later, as one that holds no number
            check_width(self.path, separator, names, rows, self.dialect.header)

    def first_error(self, first: int, block: str) -> LogError:
        """Return the error for the first cell that is not a number."""
        spaced = self.dialect.separator == " "
        text = "\n".join(" ".join(line.split()) for line in block.split("\n")) if spaced else block
        reader = csv.reader(io.StringIO(text), delimiter=self.dialect.separator)
        try:
            for row in reader:
                for name, index in zip(self.names, self.indices, strict=True) if row else ():
                    problem = _problem(row, index, self.dialect)
                    if problem is not None:
                        return LogError(self.path, problem, line=first + reader.line_num - 1, column=name)
        except csv.Error as error:
            line = first + reader.line_num - 1
            return LogError(self.path, f"cannot be parsed: {error}", line=line)
        return LogError(self.path, "cannot be parsed as columns of numbers")


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


def _line_of(line_blocks: Sequence[tuple[int, int | np.ndarray]], row: int) -> int | None:
    for count, lines in line_blocks:
        if row < count:
            return lines + row if isinstance(lines, int) else int(lines[min(row, lines.size - 1)])
        row -= count
    return None


def _lines(block: str, first: int, rows: int) -> np.ndarray | int:
    """Return the line of the first sample, or of each sample if there are blank lines."""
    if block.rstrip("\n").count("\n") + 1 == rows:
        return first
    return np.array([number for number, line in enumerate(block.split("\n"), start=first) if line.strip()])


def _problem(row: Sequence[str], index: int, dialect: Dialect) -> str | None:
    if index >= len(row):
        return f"the line has {len(row)} cells, expected {len(dialect.names)}"
    cell = row[index].strip()
    try:
        float(_with_decimal_point(cell) if dialect.comma else cell)
    except ValueError:
        pass
    else:
        if cell.isascii() and "_" not in cell:
            return None
    shown = repr(cell if len(cell) <= LONGEST_SHOWN else f"{cell[:LONGEST_SHOWN]}…")
    expected = "a number with a decimal comma, as in other cells" if dialect.comma else "a number"
    return f"expected {expected}, got {shown if cell else 'an empty cell'}"


def _blocks(path: Path) -> Iterator[str]:
    """Return the text of a plain or gzip-compressed log in blocks of whole lines.

    Raises:
        LogError: the file cannot be read, is damaged, unpacks to too many bytes, or is not text.
    """
    rest = ""
    try:
        if path.suffix.lower() == ".gz":
            _check_unpacked(path)
        for chunk in _decode_text(path):
            complete, newline, rest = (rest + chunk).rpartition("\n")
            if newline:
                yield complete + newline
    except UnicodeDecodeError as error:
        raise LogError(path, f"is not text in its encoding: {error}") from error
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(path, f"cannot be read: {error}") from error
    if rest:
        yield rest


def _check_unpacked(path: Path) -> None:
    """Refuse a file that unpacks to too many bytes, or not at all, before it is parsed."""
    max_bytes, size = max_unpacked_bytes(path), 0
    with gzip.open(path) as file:
        for chunk in iter(partial(file.read, BLOCK), b""):
            size += len(chunk)
            if size > max_bytes:
                raise LogError(
                    path, f"unpacks to more than {MAX_UNPACK_RATIO} times its size; check the file"
                )


def _decode_text(path: Path) -> Iterator[str]:
    """Yield the text in parts; in a text without line feeds, carriage returns end the lines."""
    is_gzip = path.suffix.lower() == ".gz"
    with gzip.open(path) if is_gzip else path.open("rb") as file:
        head = file.read(HEAD)
        encoding = encoding_of(head, path)
        decoder = codecs.getincrementaldecoder(encoding)("strict" if encoding == "utf-16" else "replace")
        carriage_returns = encoding != "utf-16" and b"\n" not in head
        for chunk in chain([head], iter(partial(file.read, BLOCK), b"")):
            text = decoder.decode(chunk)
            yield text.replace("\r", "\n") if carriage_returns else text
        yield decoder.decode(b"", final=True)
