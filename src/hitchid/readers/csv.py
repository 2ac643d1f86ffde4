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
    return Table(path, {name: rows[:, i] for i, name in enumerate(wanted)}, first_line=2)


def read_rows(path: Path, like: str) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a CSV log as text, exactly as they stand in the file.

    Args:
        path: the log.
        like: a column that every sample has; a CSV log has all of them.
    """
    rows = [row for row in csv.reader(io.StringIO(read_text(path))) if row]
    return rows[0], rows[1:]


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
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


def read_text(path: Path) -> str:
    """Return the text of a plain or gzip-compressed log.

    Raises:
        LogError: the file cannot be read, is damaged, or is not UTF-8 text.
    """
    try:
        data = path.read_bytes()
        if path.suffix == ".gz":
            data = gzip.decompress(data)
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise LogError(path, f"is not UTF-8 text: {error}; required a CSV log") from error
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(path, f"cannot be read: {error}") from error


def _header(path: Path, text: str) -> list[str]:
    if not text.strip():
        raise LogError(path, "the file is empty; required a header line and samples")
    names = [name.strip() for name in next(csv.reader([text.partition("\n")[0]]))]
    for name in names:
        if name and names.count(name) > 1:
            raise LogError(path, "this column name stands twice", line=1, column=name)
    return names


def _fault(path: Path, text: str, names: list[str], wanted: Sequence[str]) -> LogError:
    """Find the first cell of the wanted columns that is no number."""
    reader = csv.reader(io.StringIO(text))
    next(reader)
    for row in reader:
        for name in wanted if row else ():
            index = names.index(name)
            if index >= len(row):
                return LogError(
                    path,
                    f"the line has {len(row)} cells, required {len(names)}",
                    line=reader.line_num,
                    column=name,
                )
            try:
                float(row[index])
            except ValueError:
                came = f"'{row[index]}'" if row[index].strip() else "an empty cell"
                return LogError(path, f"required a number, came {came}", line=reader.line_num, column=name)
    return LogError(path, "cannot be understood as comma-separated numbers")
