"""Tables of results as data: numbers at full precision, units in the names of the columns."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support.dataframes import dataframe
from hitchid._support.inert import spreadsheet_text
from hitchid._support.summary import shortened

if TYPE_CHECKING:
    from pandas import DataFrame

TABLES = "tables"  # folder of the CSV files in a folder of results
Cell = str | float | int | bool | None


@dataclass(frozen=True, repr=False)
class DataTable:
    """One table of results.

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
