"""Text logs, a line a sample: separator, decimal sign, header and units as the logger wrote them."""

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

from hitchid.errors import LogError
from hitchid.readers.content import LARGEST_RATIO, OR_ELSE, Channel, Content, Wanted, largest
from hitchid.readers.formats.dialect import Dialect, check_width, dialect_of, encoding_of

SUFFIXES = (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".lvm")
HEAD, BLOCK = 2**20, 2**25
LONGEST_SHOWN = 40
UNENDED = "the last line has no line end: it may have been cut short"


def read(path: Path, wanted: Wanted) -> Content:
    """Read the wanted columns of a text log, block by block; text in other columns does no harm.

    Raises:
        LogError: the file cannot be read, or a wanted column is missing or holds something that is no number;
            the message names line and column.
    """
    blocks = _blocks(path)
    head = next(blocks, "")
    asked = () if wanted.signals is None else tuple(dict.fromkeys((wanted.time, *wanted.signals)))
    dialect = dialect_of(head[:HEAD], path, asked)
    # Where all are wanted, a name that stands twice names none.
    asked = asked or tuple(name for name, times in Counter(dialect.names).items() if name and times == 1)
    columns = _Columns(path, dialect, asked, tuple(_place(path, dialect, name) for name in asked))
    parts, last = [], "\n"
    for line, last in _below(chain([head], blocks), dialect.first):
        parts.append(columns.numbers(line, last))
    if not parts:
        raise LogError(path, "there are no samples below the header line", line=dialect.header)
    channels = {
        name: Channel(_joined([part.columns for part in parts]), dialect.units.get(dialect.names[place]))
        for name, place in reversed(list(zip(asked, columns.places, strict=True)))
    }
    lines = [(part.samples, part.lines) for part in parts]
    ordered = {name: channels[name] for name in asked}
    notices = () if last.endswith("\n") else (UNENDED,)
    return Content(path, ordered, notices, partial(_line_of, lines))


def _joined(parts: Sequence[list[np.ndarray]]) -> np.ndarray:
    """Return the last column of all parts as one that nobody can change, and take it from the parts.

    A day of samples is large: there is never more than one column of it twice.
    """
    column = np.concatenate([part.pop() for part in parts])
    column.setflags(write=False)
    return column


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a text log as text; every row has as many cells as the header.

    Numbers with a decimal comma get a point.
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
        raise LogError(path, f"cannot be understood as comma-separated text: {error}") from error
    if dialect.comma:
        rows = [
            [_pointed(cell) if cell.strip(" +-0123456789eE") == "," else cell for cell in row] for row in rows
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
    writer.writerow(header)
    writer.writerows(rows)
    data = text.getvalue().encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix.lower() == ".gz" else data)


def _pointed(text: str) -> str:
    """Return text with points for decimal commas; what were points make no number, thousands among them."""
    return text.replace(".", "?").replace(",", ".")


def _place(path: Path, dialect: Dialect, name: str) -> int:
    places = dialect.places(name)
    if len(places) > 1:
        meant = ", ".join(dialect.names[place] for place in places)
        raise LogError(path, f"several columns are meant: {meant}", line=dialect.header, column=name)
    if not places:
        found = ", ".join(dialect.names)
        raise LogError(
            path,
            f"there is no such column; {OR_ELSE}; found {found}",
            line=dialect.header,
            column=name,
        )
    return places[0]


class _Part(NamedTuple):
    """The samples of a block: how many, each column of shape [N], and the line of the first or of each."""

    samples: int
    columns: list[np.ndarray]
    lines: int | np.ndarray


class _Columns(NamedTuple):
    """The columns that are read of a log: their names, and which they are."""

    path: Path
    dialect: Dialect
    names: tuple[str, ...]
    places: tuple[int, ...]

    def numbers(self, first: int, block: str) -> _Part:
        """Return the numbers of a block that begins at a line."""
        self.check_width(first, block)
        separator = None if self.dialect.separator == " " else self.dialect.separator
        text = io.StringIO(_pointed(block) if self.dialect.comma else block)
        try:
            rows = np.loadtxt(
                text, delimiter=separator, usecols=self.places, ndmin=2, comments=None, quotechar='"'
            )
        except ValueError:
            raise self.fault(first, block) from None
        columns = [rows[:, place].copy() for place in range(len(self.places))]
        return _Part(len(rows), columns, _lines(block, first, len(rows)))

    def check_width(self, first: int, block: str) -> None:
        """Refuse rows that are wider than the header; cells are told apart only where there may be some."""
        separator, names = self.dialect.separator, self.dialect.names
        if max(line.count(separator) for line in block.split("\n")) < len(names) or separator == " ":
            return
        reader = csv.reader(io.StringIO(block), delimiter=separator)
        rows = ((first + reader.line_num - 1, [cell.strip() for cell in row]) for row in reader)
        with suppress(csv.Error):  # what cannot be told apart is no number either, and refused as none
            check_width(self.path, separator, names, rows, self.dialect.header)

    def fault(self, first: int, block: str) -> LogError:
        """Find the first cell that is no number."""
        spaced = self.dialect.separator == " "
        text = "\n".join(" ".join(line.split()) for line in block.split("\n")) if spaced else block
        reader = csv.reader(io.StringIO(text), delimiter=self.dialect.separator)
        try:
            for row in reader:
                for name, place in zip(self.names, self.places, strict=True) if row else ():
                    problem = _problem(row, place, self.dialect)
                    if problem is not None:
                        return LogError(self.path, problem, line=first + reader.line_num - 1, column=name)
        except csv.Error as error:
            line = first + reader.line_num - 1
            return LogError(self.path, f"cannot be understood: {error}", line=line)
        return LogError(self.path, "cannot be understood as columns of numbers")


def _below(blocks: Iterable[str], first: int) -> Iterator[tuple[int, str]]:
    """Return what stands from a line on, block by block, each with its first line."""
    line = 1
    for block in blocks:
        lines = block.count("\n") + (not block.endswith("\n"))
        skipped = min(max(first - line, 0), lines)
        left = block if not skipped else block.split("\n", skipped)[-1] if skipped < lines else ""
        if left.strip():
            yield line + skipped, left
        line += lines


def _line_of(parts: Sequence[tuple[int, int | np.ndarray]], row: int) -> int | None:
    for count, lines in parts:
        if row < count:
            return lines + row if isinstance(lines, int) else int(lines[min(row, lines.size - 1)])
        row -= count
    return None


def _lines(block: str, first: int, rows: int) -> np.ndarray | int:
    """Return the line of the first sample, or of each where there are others between."""
    if block.rstrip("\n").count("\n") + 1 == rows:
        return first
    return np.array([number for number, line in enumerate(block.split("\n"), start=first) if line.strip()])


def _problem(row: Sequence[str], place: int, dialect: Dialect) -> str | None:
    if place >= len(row):
        return f"the line has {len(row)} cells, required {len(dialect.names)}"
    cell = row[place].strip()
    try:
        float(_pointed(cell) if dialect.comma else cell)
    except ValueError:
        pass
    else:
        if cell.isascii() and "_" not in cell:
            return None
    shown = repr(cell if len(cell) <= LONGEST_SHOWN else f"{cell[:LONGEST_SHOWN]}…")
    sort = "a number with a decimal comma, as others have" if dialect.comma else "a number"
    return f"required {sort}, came {shown if cell else 'an empty cell'}"


def _blocks(path: Path) -> Iterator[str]:
    """Return the text of a plain or gzip-compressed log in blocks of whole lines.

    Raises:
        LogError: the file cannot be read, is damaged, unpacks to absurd size, or is no text.
    """
    rest = ""
    try:
        if path.suffix.lower() == ".gz":
            _check_unpacked(path)
        for part in _decoded(path):
            whole, end, rest = (rest + part).rpartition("\n")
            if end:
                yield whole + end
    except UnicodeDecodeError as error:
        raise LogError(path, f"is not text in its encoding: {error}") from error
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(path, f"cannot be read: {error}") from error
    if rest:
        yield rest


def _check_unpacked(path: Path) -> None:
    """Refuse what unpacks to absurd size, or does not unpack, before the first number of it is read."""
    most, size = largest(path), 0
    with gzip.open(path) as file:
        for part in iter(partial(file.read, BLOCK), b""):
            size += len(part)
            if size > most:
                raise LogError(path, f"unpacks to more than {LARGEST_RATIO} times its size; refused")


def _decoded(path: Path) -> Iterator[str]:
    """Return the text in parts; without any line feed, carriage returns end its lines."""
    packed = path.suffix.lower() == ".gz"
    with gzip.open(path) if packed else path.open("rb") as file:
        head = file.read(HEAD)
        encoding = encoding_of(head, path)
        decoder = codecs.getincrementaldecoder(encoding)("strict" if encoding == "utf-16" else "replace")
        returns = encoding != "utf-16" and b"\n" not in head
        for part in chain([head], iter(partial(file.read, BLOCK), b"")):
            text = decoder.decode(part)
            yield text.replace("\r", "\n") if returns else text
        yield decoder.decode(b"", final=True)
