"""NetCDF attributes of the CF conventions: units of time, scaling, fill values."""

from collections.abc import Mapping

import numpy as np

from hitchid.logs.formats.library import floats, unit_text
from hitchid.logs.units import UNITS, parse_unit


def is_time(unit: str | None) -> bool:
    """Return whether a unit is one of time, with or without `since ...`."""
    return _seconds_per_unit(unit) is not None


def to_seconds(values: np.ndarray, unit: str | None) -> np.ndarray:
    """Return times in seconds, rounded once; unchanged if the unit is not one of time."""
    factor = _seconds_per_unit(unit) or 1.0
    if factor == 1.0:
        return values
    return values / round(1 / factor) if factor < 1.0 else values * factor


def decode_values(raw: np.ndarray, attributes: Mapping[str, object]) -> np.ndarray:
    """Return physical from stored numbers: scaled, shifted, NaN where filled or out of the valid range.

    Args:
        raw: as stored, any shape with one long side.
        attributes: those of the variable; `scale_factor`, `add_offset`, `_FillValue`, `missing_value`,
            `valid_range`, `valid_min`, `valid_max` and `_Unsigned` count.
    """
    stored = _as_unsigned(np.asarray(raw).ravel(), attributes)
    values = floats(stored)
    lowest, highest = _valid_range(attributes)
    values[(values < lowest) | (values > highest)] = np.nan
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


def _as_unsigned(stored: np.ndarray, attributes: Mapping[str, object]) -> np.ndarray:
    """Return integers as unsigned if the attribute `_Unsigned` is set: NetCDF 3 has no unsigned type."""
    unsigned = (unit_text(attributes.get("_Unsigned")) or "").lower() == "true"
    return (
        stored.view(f"{stored.dtype.byteorder}u{stored.dtype.itemsize}")
        if unsigned and stored.dtype.kind == "i"
        else stored
    )


def _valid_range(attributes: Mapping[str, object]) -> tuple[float, float]:
    """Return the range of valid stored numbers."""
    limits = np.asarray(attributes.get("valid_range", ())).ravel()
    if limits.size == 2 and limits.dtype.kind in "fiu":
        return float(limits[0]), float(limits[1])
    lowest, highest = (_number(attributes.get(name)) for name in ("valid_min", "valid_max"))
    return -np.inf if lowest is None else lowest, np.inf if highest is None else highest


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
