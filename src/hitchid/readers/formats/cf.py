"""What NetCDF attributes say of numbers: units of time, scaling, fill values."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hitchid.readers.formats.extra import floats, spelled


class _Tick(NamedTuple):
    factor: float
    divisor: float


_SPELLINGS = {
    _Tick(1.0, 1e9): ("ns", "nsec", "nanosecond", "nanoseconds"),
    _Tick(1.0, 1e6): ("us", "µs", "μs", "usec", "microsecond", "microseconds"),
    _Tick(1.0, 1e3): ("ms", "msec", "millisec", "millisecs", "millisecond", "milliseconds"),
    _Tick(1.0, 1.0): ("s", "sec", "secs", "second", "seconds"),
    _Tick(60.0, 1.0): ("min", "mins", "minute", "minutes"),
    _Tick(3600.0, 1.0): ("h", "hr", "hrs", "hour", "hours"),
    _Tick(86400.0, 1.0): ("d", "day", "days"),
}
_TICKS = {spelling: tick for tick, spellings in _SPELLINGS.items() for spelling in spellings}


def is_time(unit: str | None) -> bool:
    """Return whether the unit is one of time, with or without `since ...`."""
    return _tick(unit) is not None


def in_seconds(values: np.ndarray, unit: str | None) -> np.ndarray:
    """Return times in seconds, rounded once; as they are where the unit is none of time."""
    tick = _tick(unit) or _Tick(1.0, 1.0)
    return values if tick == (1.0, 1.0) else values * tick.factor / tick.divisor


def decoded(raw: np.ndarray, attributes: Mapping[str, object]) -> np.ndarray:
    """Return the numbers that stored ones stand for: scaled, shifted, NaN where they are filled.

    Args:
        raw: as stored, any shape with one long side.
        attributes: those of the variable; `scale_factor`, `add_offset`, `_FillValue`, `missing_value` count.
    """
    values = floats(raw)
    stored = np.asarray(raw).ravel()
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


def unit_in(attributes: Mapping[str, object]) -> str | None:
    """Return the unit among the attributes, None where there is none."""
    return spelled(attributes.get("units")) or spelled(attributes.get("unit"))


def _tick(unit: str | None) -> _Tick | None:
    word = (unit or "").strip().partition(" since ")[0].strip()
    return _TICKS.get(word if len(word) < 3 else word.lower())  # "S" is siemens


def _number(value: object) -> float | None:
    number = np.asarray(value).ravel()
    return float(number[0]) if number.size == 1 and number.dtype.kind in "fiu" else None
