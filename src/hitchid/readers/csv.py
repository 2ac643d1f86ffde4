"""Comma-separated logs with one header line, plain or gzip-compressed."""

import csv
import gzip
import io
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hitchid.errors import LogError
from hitchid.readers.table import Table

SUFFIXES = (".csv", ".csv.gz")
LONGEST_SHOWN = 40


def read_table(path: Path, wanted: Sequence[str]) -> Table:
    """Read the wanted columns of a CSV log; text in other columns does no harm.

    Raises:
        LogError: the file cannot be read, or a wanted column is missing or holds something that is no number;
            the message names line and column.
    """
    text = read_text(path)
    names = _header(path, text)
    for name in wanted:
        if name not in names:
            hint = "" if "," in text.partition("\n")[0] else " (required commas between columns)"
            found = f"there is no such column; required it, found {', '.join(names)}{hint}"
            raise LogError(path, found, line=1, column=name)
    indices = [names.index(name) for name in wanted]
    body = io.StringIO(text)
    body.readline()
    if not text.partition("\n")[2].strip():
        raise LogError(path, "there are no samples below the header line", line=1)
    try:
        rows = np.loadtxt(body, delimiter=",", usecols=indices, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        raise _fault(path, text, names, wanted) from None
    lines = [number for number, line in enumerate(text.split("\n"), start=1) if line.strip()]
    return Table(
        path, {name: rows[:, i] for i, name in enumerate(wanted)}, np.array(lines[1 : len(rows) + 1])
    )


def read_rows(path: Path, like: str) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a CSV log as text; every row has as many cells as the header.

    Args:
        path: the log.
        like: a column that every sample has; a CSV log has all of them.
    """
    text = read_text(path)
    header = _header(path, text)
    try:
        rows = [row for row in csv.reader(io.StringIO(text)) if row][1:]
    except csv.Error as error:
        raise LogError(path, f"cannot be understood as comma-separated text: {error}") from error
    width = len(header)
    return header, [row[:width] + [""] * (width - len(row)) for row in rows]


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


def read_text(path: Path) -> str:
    """Return the text of a plain or gzip-compressed log.

    Raises:
        LogError: the file cannot be read, is damaged, or is not UTF-8 text.
    """
    try:
        data = path.read_bytes()
        if path.suffix.lower() == ".gz":
            data = gzip.decompress(data)
        text = data.decode("utf-8-sig")
        return text if "\n" in text else text.replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise LogError(path, f"is not UTF-8 text: {error}; required a CSV log") from error
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(path, f"cannot be read: {error}") from error


def _header(path: Path, text: str) -> list[str]:
    if not text.strip():
        raise LogError(path, "the file is empty; required a header line and samples")
    try:
        names = [name.strip() for name in next(csv.reader([text.partition("\n")[0]]), [])]
    except csv.Error as error:
        raise LogError(path, f"cannot be understood as a header line: {error}", line=1) from error
    for name in names:
        if name and names.count(name) > 1:
            raise LogError(path, "this column name stands twice", line=1, column=name)
    return names


def _fault(path: Path, text: str, names: list[str], wanted: Sequence[str]) -> LogError:
    """Find the first cell of the wanted columns that is no number."""
    reader = csv.reader(io.StringIO(text))
    try:
        next(reader)
        for row in reader:
            for name in wanted if row else ():
                problem = _problem(row, names.index(name), len(names))
                if problem is not None:
                    return LogError(path, problem, line=reader.line_num, column=name)
    except csv.Error as error:
        return LogError(path, f"cannot be understood: {error}", line=reader.line_num)
    return LogError(path, "cannot be understood as comma-separated numbers")


def _problem(row: Sequence[str], index: int, width: int) -> str | None:
    if index >= len(row):
        return f"the line has {len(row)} cells, required {width}"
    cell = row[index].strip()
    try:
        float(cell)
    except ValueError:
        pass
    else:
        if cell.isascii() and "_" not in cell:
            return None
    shown = repr(cell if len(cell) <= LONGEST_SHOWN else f"{cell[:LONGEST_SHOWN]}…")
    return f"required a number, came {shown if cell else 'an empty cell'}"
