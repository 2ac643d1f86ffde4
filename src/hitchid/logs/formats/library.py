"""Functions shared by the readers of optional formats: libraries, damaged files, names, CF attributes."""

import importlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, match_channels
from hitchid.logs.units import UNITS, parse_unit

MAX_COLUMNS = 1000  # of a table; wider arrays are pictures or maps (chosen)
DISTRIBUTIONS = {"can": "python-can", "nptdms": "npTDMS"}


def import_optional(module: str, extra: str, path: Path, purpose: str = "read") -> ModuleType:
    """Return an optional module, which an extra of this package installs, to `read` or `write` a file."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        library = DISTRIBUTIONS.get(package, package)
        raise LogError(
            path, f"{library} is required to {purpose} it: pip install 'hitchid[{extra}]'"
        ) from error


@contextmanager
def as_log_errors(path: Path, kind: str) -> Iterator[None]:
    """Turn any exception of a library into an error that names the file."""
    try:
        yield
    # A lack of memory is told apart by the reader process: the file may be intact.
    except (LogError, MemoryError):
        raise
    except Exception as error:  # libraries raise anything on damaged files, down to AttributeError
        detail = str(error) or type(error).__name__
        raise LogError(path, f"cannot be read as {kind}: {detail}") from error


def match_clocked_channels(
    source: Path, names: Sequence[str], selection: ChannelSelection, clocked: Collection[str]
) -> dict[str, str]:
    """Return requested name to full name; the time is optional if all requested channels are `clocked`."""
    matches = match_channels(source, names, selection, has_clocks=True)
    if all(name in clocked for name in matches.values()):
        return matches
    return match_channels(source, names, selection)


def unique_names(names: Sequence[str]) -> list[str]:
    """Return the names, repeated ones with a number behind them, so that all differ."""
    unique: dict[str, None] = {}
    for name in names:
        number, candidate = 1, name
        while candidate in unique:
            number += 1
            candidate = f"{name} ({number})"
        unique[candidate] = None
    return list(unique)


def floats(values: np.ndarray) -> np.ndarray:
    """Return real numbers as a vector of doubles, copied."""
    return np.array(values, dtype=np.float64).ravel()


def is_vector(shape: Sequence[int]) -> bool:
    """Return whether an array of this shape is one row or column of more than one number."""
    return len(shape) in (1, 2) and max(shape) > 1 and (len(shape) == 1 or min(shape) == 1)


def is_matrix(shape: Sequence[int]) -> bool:
    """Return whether an array of this shape is a table: samples along its longer side, several columns."""
    return len(shape) == 2 and 1 < min(shape) < max(shape) and min(shape) <= MAX_COLUMNS


def column_of(matrix: Any, index: int) -> np.ndarray:
    """Return a column of a table: the samples along its longer side, whichever that is."""
    return matrix[:, index] if matrix.shape[0] > matrix.shape[1] else matrix[index, :]


def column_names(name: str, shape: Sequence[int]) -> list[str]:
    """Return the names of the columns of a table, as MATLAB counts them: `data(:,1)`, `data(:,2)`, …."""
    return [f"{name}(:,{number})" for number in range(1, min(shape) + 1)]


def unit_text(unit: object) -> str | None:
    """Return a unit as written in the file, None if it is blank or not text."""
    if isinstance(unit, np.ndarray) and unit.size == 1:
        unit = unit.ravel()[0]
    if isinstance(unit, bytes):
        unit = unit.decode("utf-8", errors="replace")
    if not isinstance(unit, str):
        return None
    return unit.strip(" \0\t\r\n") or None


# Attributes of the CF conventions of NetCDF: units of time, scaling, fill values.


def is_time(unit: str | None) -> bool:
    """Return whether a unit is one of time, with or without `since ...`."""
    return _seconds_per_unit(unit) is not None


def to_seconds(values: np.ndarray, unit: str | None) -> np.ndarray:
    """Return times in seconds, rounded once; unchanged if the unit is not one of time."""
    factor = _seconds_per_unit(unit) or 1.0
    if factor == 1.0:
        return values
    # By a whole number: 1 ms times 1e-3 would be rounded twice.
    return values / round(1 / factor) if factor < 1.0 else values * factor


def decode_values(raw: np.ndarray, attributes: Mapping[str, object]) -> np.ndarray:
    """Return physical from stored numbers: scaled, shifted, NaN where filled or out of the valid range.

    Args:
        raw: as stored, any shape with one long side.
        attributes: those of the variable; `scale_factor`, `add_offset`, `_FillValue`, `missing_value`,
            `valid_range`, `valid_min`, `valid_max` and `_Unsigned` count.
    """
    stored = np.asarray(raw).ravel()
    # NetCDF 3 has no unsigned type.
    is_unsigned = (unit_text(attributes.get("_Unsigned")) or "").lower() == "true"
    if is_unsigned and stored.dtype.kind == "i":
        stored = stored.view(f"{stored.dtype.byteorder}u{stored.dtype.itemsize}")
    values = floats(stored)
    limits = np.asarray(attributes.get("valid_range", ())).ravel()
    if limits.size == 2 and limits.dtype.kind in "fiu":
        lowest, highest = limits.tolist()
    else:
        lowest, highest = (_number(attributes.get(name)) for name in ("valid_min", "valid_max"))
    # Stored numbers, before scaling: that is how CF states the valid range.
    values[values < (-np.inf if lowest is None else float(lowest))] = np.nan
    values[values > (np.inf if highest is None else float(highest))] = np.nan
    for name in ("_FillValue", "missing_value"):
        fills = np.asarray(attributes.get(name, ()))
        if fills.dtype.kind in "fiu" and fills.size:
            values[np.isin(stored, fills)] = np.nan
    scale, offset = (_number(attributes.get(name)) for name in ("scale_factor", "add_offset"))
    if scale is not None:
        values *= scale
    if offset is not None:
        values += offset
    return values


def unit_attribute(attributes: Mapping[str, object]) -> str | None:
    """Return the unit among the attributes, None if there is none."""
    return unit_text(attributes.get("units")) or unit_text(attributes.get("unit"))


def _seconds_per_unit(unit: str | None) -> float | None:
    """Return the seconds in a unit of time, None for any other unit."""
    unit_name = parse_unit((unit or "").partition(" since ")[0])
    return UNITS[unit_name].factor if unit_name and UNITS[unit_name].dimension == "time" else None


def _number(value: object) -> float | None:
    number = np.asarray(value).ravel()
    return float(number[0]) if number.size == 1 and number.dtype.kind in "fiu" else None
