"""The ledger of a fleet: what lies in the store of results is what has been done."""

import re
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from hitchid.errors import InputError
from hitchid.fleet.row import FAILED, MAX_BYTES, OneRow, Row, TaskRow
from hitchid.fleet.store import KEY_LENGTH, Store

if TYPE_CHECKING:
    from hitchid._support.tables import DataTable

# Rows of a fleet as one table, CSV and Parquet.

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
    from hitchid._support.tables import DataTable  # imports NumPy, before which a worker takes its core

    table = DataTable.of_rows("fleet", table_rows(rows))
    store.write(TABLE_FILE, table.csv())
    store.write(PARQUET_FILE, parquet(table))


def parquet(table: "DataTable") -> bytes:
    """Return a table as a Parquet file.

    Raises:
        InputError: pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow.parquet import write_table
    except ImportError as error:
        raise InputError("pyarrow is required for fleets: pip install 'hitchid[fleet]'") from error
    columns = {name: [row[index] for row in table.rows] for index, name in enumerate(table.columns)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / PARQUET_FILE
        write_table(pa.table(columns), path)
        return path.read_bytes()


MODELS, ROWS, SUFFIX = "models", "rows", ".json"
MODEL_FILE = "model.json"  # written last: a folder without it is no model


def row_name(machine: str, signature: str) -> str:
    """Return the name of the row of a machine in a store of results."""
    return f"{ROWS}/{machine}/{signature}{SUFFIX}"


def model_name(machine: str, key: str) -> str:
    """Return the name of the folder of a model in a store of results."""
    return f"{MODELS}/{machine}/{key}"


def rows_in(store: Store) -> frozenset[str]:
    """Return the names of all rows in a store, without reading one."""
    return frozenset(f"{ROWS}/{file.name}" for file in store.below(ROWS).files())


def read_rows(
    store: Store, names: Iterable[str] | None = None, row_type: type[OneRow] = Row
) -> tuple[OneRow, ...]:
    """Return rows of a store in the order of machine and date.

    Args:
        store: of results.
        names: of the rows; None for all.
        row_type: what they are the outcome of.

    Raises:
        InputError: a file is not a row, or that of another machine or signature than its name says.
        StoreError: the store cannot be read.
    """
    chosen = sorted(rows_in(store) if names is None else names)
    rows = []
    for name, content in store.read_many(chosen, most=MAX_BYTES + 1).items():
        row = row_type.from_json(content, name)
        # A row that was copied to another machine would make it one that is done.
        if name != row_name(row.machine, row.signature):
            raise InputError(f"{name}: is the row of {row.machine}, {row.signature}; expected its own place")
        rows.append(row)
    return tuple(sorted(rows, key=lambda row: (row.machine, row.date, row.signature)))


def newest(rows: Iterable[OneRow]) -> tuple[OneRow, ...]:
    """Return the last row of each machine; of several of one date, one that did not fail."""
    # The signature last: rows of one date come in the same order whoever lists them.
    ordered = sorted(rows, key=lambda row: (row.machine, row.date, row.state != FAILED, row.signature))
    return tuple({row.machine: row for row in ordered}.values())


def load_model(store: Store, row: Row, folder: Path) -> Path:
    """Write the model of a row into a local folder, and return that of `hitchid.load`.

    Raises:
        InputError: the key of the row is none, and may be a path out of the folder.
        StoreError: the model cannot be read.
    """
    if not re.fullmatch(rf"[0-9a-f]{{{KEY_LENGTH}}}", row.key):
        raise InputError(f"{row.machine}: key: got '{row.key:.40}', expected {KEY_LENGTH} hexadecimal digits")
    name = model_name(row.machine, row.key)
    target = folder / row.key
    target.mkdir(parents=True, exist_ok=True)
    files = store.below(name).files()
    for file, content in store.read_many([f"{name}/{file.name}" for file in files]).items():
        # The name alone: a store of another's making must not write beside the folder.
        (target / Path(file).name).write_bytes(content)
    return target
