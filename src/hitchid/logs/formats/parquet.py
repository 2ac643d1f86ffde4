"""Parquet files: columns of numbers and time stamps, with units in the metadata of their fields."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content, LogChannel, match_channels
from hitchid.logs.formats.library import as_log_errors, floats, import_optional, unit_text
from hitchid.logs.units import unit_of_column

SUFFIXES = (".parquet",)
KIND = "a Parquet file"
TICKS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}  # 1/s of the units of Arrow's time stamps


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected columns of a Parquet file; time stamps become seconds since the first."""
    arrow, parquet = (import_optional(module, "parquet", path) for module in ("pyarrow", "pyarrow.parquet"))
    # From the open file: Arrow opens no path that is not UTF-8.
    with (
        as_log_errors(path, KIND),
        path.open("rb") as stream,
        parquet.ParquetFile(stream, page_checksum_verification=True) as file,
    ):
        # One row is a table of parameters, not a log.
        fields = list(file.schema_arrow) if file.metadata.num_rows > 1 else []
        numeric_fields = {field.name: field for field in fields if _holds_numbers(arrow, field.type)}
        matches = match_channels(path, list(numeric_fields), selection)
        for name in matches.values():
            if sum(field.name == name for field in fields) > 1:
                raise LogError(path, "several columns have this name", column=name)
        table = file.read(columns=list(matches.values()))
        channels = {
            requested: _channel(arrow, numeric_fields[name], table.column(name))
            for requested, name in matches.items()
        }
    return Content(path, channels)


def write_table(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns of doubles, each under a name that may end in its unit, with a checksum for each page."""
    arrow, parquet = (
        import_optional(module, "parquet", path, purpose="write") for module in ("pyarrow", "pyarrow.parquet")
    )
    fields = [
        arrow.field(
            name, arrow.float64(), metadata={"unit": unit} if (unit := unit_of_column(name)) else None
        )
        for name in columns
    ]
    arrays = [arrow.array(floats(values)) for values in columns.values()]
    table = arrow.Table.from_arrays(arrays, schema=arrow.schema(fields))
    with path.open("wb") as stream:
        parquet.write_table(table, stream, use_dictionary=False, write_page_checksum=True)


def _holds_numbers(arrow: Any, kind: Any) -> bool:
    types = arrow.types
    if types.is_dictionary(kind):
        kind = kind.value_type
    type_checks = (types.is_integer, types.is_floating, types.is_boolean, types.is_decimal)
    return any(type_check(kind) for type_check in (*type_checks, types.is_timestamp, types.is_duration))


def _channel(arrow: Any, field: Any, column: Any) -> LogChannel:
    """Return the numbers of a column; time stamps as seconds since the first, durations as seconds."""
    types = arrow.types
    if types.is_dictionary(field.type):
        column = column.cast(field.type.value_type)
    if types.is_timestamp(column.type) or types.is_duration(column.type):
        valid = column.is_valid().to_numpy()
        ticks = column.cast(arrow.int64()).fill_null(0).to_numpy()
        if valid.any() and types.is_timestamp(column.type):
            ticks = ticks - ticks[np.argmax(valid)]  # as integers: a double cannot represent a date in ns
        return LogChannel(np.where(valid, ticks / TICKS[column.type.unit], np.nan), "s")
    metadata = field.metadata or {}
    unit = unit_text(metadata.get(b"unit")) or unit_text(metadata.get(b"units"))
    if types.is_boolean(column.type):
        column = column.cast(arrow.uint8())
    return LogChannel(floats(column.cast(arrow.float64(), safe=False).to_numpy()), unit)
