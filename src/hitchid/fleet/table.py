"""Rows of a fleet as one table, CSV and Parquet."""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from hitchid._support.data_table import DataTable
from hitchid.errors import InputError
from hitchid.fleet.row import TaskRow
from hitchid.fleet.store import Store

TABLE_FILE, PARQUET_FILE = "fleet.csv", "fleet.parquet"


def table_rows(rows: Iterable[TaskRow]) -> list[dict[str, str | float | int | None]]:
    """Return one flat line for each machine, column to value."""
    lines = []
    for row in rows:
        line: dict[str, str | float | int | None] = {}
        for name, value in vars(row).items():
            if isinstance(value, str | tuple):
                line[name] = value if isinstance(value, str) else "; ".join(value)
        for direction, figures in row.directions.items():
            line |= {f"{direction}_{name}": value for name, value in vars(figures).items()}
        if row.cost is not None:
            line |= vars(row.cost)
        lines.append(line)
    return lines


def compact(store: Store, rows: Iterable[TaskRow]) -> None:
    """Write the rows as one table, a line for each machine, as CSV and Parquet.

    Raises:
        InputError: pyarrow is not installed.
        StoreError: the store cannot be written.
    """
    table = DataTable.of_rows("fleet", table_rows(rows))
    store.write(TABLE_FILE, table.csv())
    store.write(PARQUET_FILE, parquet(table))


def parquet(table: DataTable) -> bytes:
    """Return a table as a Parquet file.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow.parquet import write_table
    except ImportError as error:
        raise InputError("pyarrow is required for fleets: pip install 'hitchid[fleet]'") from error
    columns = {name: [row[place] for row in table.rows] for place, name in enumerate(table.columns)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / PARQUET_FILE
        write_table(pa.table(columns), path)
        return path.read_bytes()
