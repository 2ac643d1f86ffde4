"""Tables: records in columns, which are text on pages and screens, and data at full precision in files."""

import abc
import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchid._support import numbers
from hitchid._support.inert import html_text, spreadsheet_text
from hitchid._support.records import short_repr
from hitchid._support.screen import GAP, MAX_WIDTH, NOTE_LINES, screen, shortened, wrapped
from hitchid.errors import InputError

if TYPE_CHECKING:
    from pandas import DataFrame


class Faint(str):
    """A cell of a table in grey: the best-fit value of what the tests do not determine."""

    __slots__ = ()


@short_repr
@dataclass(frozen=True)
class Table:
    """A table of text, for pages and screens.

    Attributes:
        title: what it shows, without full stop.
        header: of each column.
        rows: texts of the cells, names in the first column; on a screen the last column is wrapped.
        notes: sentences below the table, as text at most three lines each.
        pictures: SVG element of each row, shown in HTML only; empty for none.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = field(default=(), repr=False)
    pictures: tuple[str, ...] = field(default=(), repr=False)

    @property
    def numeric(self) -> list[bool]:
        """Whether each column contains numbers."""
        columns = zip(*self.rows, strict=True) if self.rows else [()] * len(self.header)
        return [any(column) and all(map(_is_number, column)) for column in columns]

    def text(self) -> str:
        """Return at most 25 lines of at most 110 characters."""
        rows = [self.header, *self.rows]
        widths = [min(max(map(len, column)), MAX_WIDTH // 3) for column in zip(*rows, strict=True)][:-1]
        lines = [shortened(self.title)]
        for *cells, last in rows:
            padded = [shortened(cell, width).ljust(width) for cell, width in zip(cells, widths, strict=True)]
            lines += wrapped(GAP + "".join(cell + GAP for cell in padded), last)
        notes = [line for note in self.notes for line in wrapped(GAP, note)[:NOTE_LINES]]
        return screen(lines, notes)

    def html(self) -> str:
        """Return an HTML element with the table; text is escaped, colours are those of the page."""
        head = _html_row("th", [*self.header, *([""] if self.pictures else [])])
        pictures = self.pictures or ("",) * len(self.rows)
        rows = "".join(
            _html_row("td", row, f"<td>{picture}</td>" if self.pictures else "")
            for row, picture in zip(self.rows, pictures, strict=True)
        )
        notes = "".join(f"<div>{html_text(note)}</div>" for note in self.notes)
        return (
            f"<div><strong>{html_text(self.title)}</strong>"
            f"<table><thead>{head}</thead><tbody>{rows}</tbody></table>{notes}</div>"
        )


def _is_number(cell: str) -> bool:
    return cell in ("diverged", "any") or not any(letter.isalpha() for letter in cell.replace("e", ""))


def _html_row(tag: str, cells: Iterable[str], end: str = "") -> str:
    style = ' style="text-align: left"'
    return "<tr>" + "".join(f"<{tag}{style}>{html_text(cell)}</{tag}>" for cell in cells) + end + "</tr>"


class Summarised(abc.ABC):
    """Base of an object that shows itself as a table; a dataclass is declared with `repr=False`."""

    @abc.abstractmethod
    def _summary(self) -> Table:
        """Return what is shown."""

    def __repr__(self) -> str:
        """Return the summary as text, at most 25 lines."""
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


# Tables as data; pandas is imported only where a DataFrame is requested.


def dataframe(table: Mapping[str, object] | Sequence[Mapping[str, object]]) -> "DataFrame":
    """Return columns, or rows that are column name to value, as a DataFrame; None becomes a missing value.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError("pandas is required for DataFrames: pip install 'hitchid[pandas]'") from error
    return pd.DataFrame(dict(table) if isinstance(table, Mapping) else list(table))


TABLES = "tables"  # folder of the CSV files in a folder of results
Cell = str | float | int | bool | None


@dataclass(frozen=True, repr=False)
class DataTable:
    """A table of values, for files and programs.

    Attributes:
        name: of its file without suffix, and of its sheet in a workbook.
        columns: names with units, such as `rmse_mm`.
        rows: cells in the order of the columns; None where there is no value.
    """

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @classmethod
    def of_rows(cls, name: str, rows: Iterable[Mapping[str, Cell]]) -> "DataTable":
        """Return a table of rows, each column to value; columns in the order of their first appearance."""
        all_rows = list(rows)
        columns = tuple(dict.fromkeys(column for row in all_rows for column in row))
        return cls(name, columns, tuple(tuple(row.get(column) for column in columns) for row in all_rows))

    @classmethod
    def of_columns(cls, name: str, columns: Mapping[str, Sequence[Cell] | np.ndarray]) -> "DataTable":
        """Return a table of columns; shorter ones end with empty cells."""
        cells = [values.tolist() if isinstance(values, np.ndarray) else values for values in columns.values()]
        return cls(name, tuple(columns), tuple(zip_longest(*cells)))

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return shortened(f"DataTable({self.name!r}: {len(self.rows)} rows of {', '.join(self.columns)})")

    def csv(self) -> bytes:
        """Return the table as CSV in UTF-8: numbers as read back exactly, empty cells for no value."""
        stream = StringIO(newline="")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(map(spreadsheet_text, self.columns))
        writer.writerows([_text(cell) for cell in row] for row in self.rows)
        return stream.getvalue().encode("utf-8", errors="replace")

    def to_dataframe(self) -> "DataFrame":
        """Return the table as a pandas DataFrame.

        Raises:
            InputError: pandas is not installed.
        """
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return dataframe(rows).reindex(columns=list(self.columns))


# One list of columns is what a fact looks like, on pages and in files. Text and value are functions of the
# whole record: on a page one cell may say several of its fields, such as a value to the digits of its error.


@dataclass(frozen=True)
class Column:
    """One column of a table of records.

    Attributes:
        key: name in files, with its unit, such as `rmse_mm`; empty for a column of pages alone.
        label: heading on pages, such as `RMSE / mm`; empty for a column of files alone.
        value: record to the cell in files, at full precision; None where the record has no value.
        text: record to the cell on pages; the value where it is left out.
    """

    key: str = ""
    label: str = ""
    value: Callable[[Any], Any] = field(default=lambda record: None)
    text: Callable[[Any], str] | None = None

    def shown(self, record: object) -> str:
        """Return the cell of a record on pages."""
        return str(self.value(record)) if self.text is None else self.text(record)


def field_of(name: str) -> Callable[[Any], Any]:
    """Return a function for a field of a record, which is None where the record has no such field."""
    return lambda record: getattr(record, name, None)


def field_column(name: str, label: str | None = None, text: Callable[[Any], str] | None = None) -> Column:
    """Return a column of a field, called by the field's name in files and, without a label, on pages."""
    return Column(name, name if label is None else label, field_of(name), text)


def number_column(key: str, label: str, value: Callable[[Any], Any]) -> Column:
    """Return a column of numbers, on pages to four digits."""
    return Column(key, label, value, lambda record: numbers.digits(value(record)))


def interval_columns(
    key: str, label: str, interval: Callable[[Any], Any], text: Callable[[Any], str] | None = None
) -> tuple[Column, ...]:
    """Return an interval as a column for each end in files, one column on pages.

    Args:
        key: name in files, `{}` for `lower` and `upper`.
        label: heading on pages.
        interval: record to the two ends; None where it has no interval.
        text: record to the cell on pages; the interval where it is left out.
    """
    return (
        Column(key.replace("{}", "lower", 1), value=lambda record: (interval(record) or (None, None))[0]),
        Column(key.replace("{}", "upper", 1), value=lambda record: (interval(record) or (None, None))[1]),
        Column(label=label, text=text or (lambda record: numbers.interval(interval(record)))),
    )


@dataclass(frozen=True)
class RecordTable:
    """Records in columns.

    Attributes:
        name: of its file without suffix, and of its sheet in a workbook.
        title: on pages, without full stop.
        columns: of both.
        records: one a row.
        file_records: further ones, in files alone.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    records: tuple[Any, ...]
    file_records: tuple[Any, ...] = ()

    def shown(self) -> Table:
        """Return the table for pages."""
        columns = [column for column in self.columns if column.label]
        rows = tuple(tuple(column.shown(record) for column in columns) for record in self.records)
        return Table(self.title, tuple(column.label for column in columns), rows)

    def data(self) -> DataTable:
        """Return the table for files; without records it has no columns."""
        records = (*self.records, *self.file_records)
        # As `DataTable.of_rows` has it, which knows no columns without a row.
        columns = [column for column in self.columns if column.key and records]
        rows = tuple(tuple(column.value(record) for column in columns) for record in records)
        return DataTable(self.name, tuple(column.key for column in columns), rows)


def stacked(tables: Mapping[str, Mapping[str, DataTable]], key: str) -> dict[str, DataTable]:
    """Return tables of the same name below each other, with a first column for their origin.

    Args:
        tables: origin to name to table.
        key: name of the first column.
    """
    rows: dict[str, list[Mapping[str, Cell]]] = {}
    for origin, by_name in tables.items():
        for name, table in by_name.items():
            rows.setdefault(name, []).extend(
                {key: origin, **dict(zip(table.columns, row, strict=True))} for row in table.rows
            )
    return {name: DataTable.of_rows(name, table_rows) for name, table_rows in rows.items()}


def csv_files(tables: Iterable[DataTable], folder: str = TABLES) -> dict[str, bytes]:
    """Return the CSV file of each table, `folder/name.csv` to content."""
    return {f"{folder}/{table.name}.csv": table.csv() for table in tables}


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    return repr(float(cell)) if isinstance(cell, float) else spreadsheet_text(str(cell))
