"""Table of the units of logs, and conversion between units of one dimension."""

from typing import NamedTuple

from hitchid.errors import InputError


class _Unit(NamedTuple):
    """Dimension of a unit, and factor to the SI unit."""

    dimension: str
    factor: float


_DEGREE = 3.141592653589793 / 180.0  # rad

UNITS: dict[str, _Unit] = {
    "A": _Unit("current", 1.0),
    "mA": _Unit("current", 1e-3),
    "V": _Unit("voltage", 1.0),
    "percent": _Unit("ratio", 1e-2),
    "1": _Unit("ratio", 1.0),
    "m": _Unit("length", 1.0),
    "cm": _Unit("length", 1e-2),
    "mm": _Unit("length", 1e-3),
    "in": _Unit("length", 0.0254),
    "deg": _Unit("angle", _DEGREE),
    "rad": _Unit("angle", 1.0),
    "bar": _Unit("pressure", 1e5),
    "MPa": _Unit("pressure", 1e6),
    "kPa": _Unit("pressure", 1e3),
    "Pa": _Unit("pressure", 1.0),
    "psi": _Unit("pressure", 6894.757293168361),
    "s": _Unit("time", 1.0),
    "ms": _Unit("time", 1e-3),
    "us": _Unit("time", 1e-6),
    "ns": _Unit("time", 1e-9),
    "min": _Unit("time", 60.0),
    "h": _Unit("time", 3600.0),
    "d": _Unit("time", 86400.0),
    "mV": _Unit("voltage", 1e-3),
    "kV": _Unit("voltage", 1e3),
    "um": _Unit("length", 1e-6),
    "mbar": _Unit("pressure", 1e2),
    "hPa": _Unit("pressure", 1e2),
    "Hz": _Unit("frequency", 1.0),
    "rpm": _Unit("frequency", 1 / 60),
    "1/min": _Unit("frequency", 1 / 60),
    "m3/s": _Unit("flow", 1.0),
    "l/min": _Unit("flow", 1e-3 / 60),
    "m/s": _Unit("speed", 1.0),
    "mm/s": _Unit("speed", 1e-3),
    "N": _Unit("force", 1.0),
    "kN": _Unit("force", 1e3),
    # Two dimensions: their zeros differ, and conversion is only by a factor.
    "degC": _Unit("temperature above freezing", 1.0),
    "K": _Unit("absolute temperature", 1.0),
}
# Units that are not read from the ending of a column name: cylinder_1, lowest value, height.
NOT_COLUMN_SUFFIXES = ("1", "min", "h", "d")

# Unit to its further spellings in files, in lower case.
_SPELLINGS_BY_UNIT = {
    "percent": "% pct prozent",
    "1": "-",
    "A": "ampere amp amps",
    "V": "volt volts",
    "m": "meter metre",
    "in": "inch inches \" \u2033 ''",
    "deg": "° º ˚ degree degrees grad",
    "rad": "radian radians",
    "s": "sec second seconds secs sek sekunde sekunden",
    "ms": "msec millisecond milliseconds millisec millisecs",
    "us": "usec µs μs microsecond microseconds",
    "ns": "nsec nanosecond nanoseconds",
    "min": "minute minutes mins",
    "h": "hour hours hr hrs",
    "d": "day days",
    "um": "µm μm micron microns",
    "mV": "millivolt",
    "mA": "milliampere milliamp milliamps",
    "mm": "millimeter millimetre",
    "rpm": "r/min rev/min",
    "1/min": "u/min min-1 min^-1",
    "l/min": "lpm",
    "m3/s": "m³/s m^3/s",
    "N": "newton",
    "degC": "°c ºc ℃ celsius",
    "K": "kelvin",
}
# Loggers write units in any case: in these dimensions no two units differ by it.
SPELLINGS = {unit.lower(): unit for unit in UNITS} | {
    spelling: unit for unit, text in _SPELLINGS_BY_UNIT.items() for spelling in text.split()
}


def parse_unit(spelling: str) -> str | None:
    """Return the unit of a spelling in a file, such as `%`, `MM` or `Volts`; None if it is unknown."""
    bare = spelling.strip().strip("[]()").strip()
    if bare in UNITS:
        return bare
    return SPELLINGS.get(bare.removesuffix(".").lower())


def check_unit(unit: str, where: str) -> str:
    """Return `unit` if it is known, else raise `InputError`, which begins with `where`."""
    if not isinstance(unit, str) or unit not in UNITS:
        raise InputError(f"{where}: unit '{unit}' is not known; expected one of {', '.join(UNITS)}")
    return unit


def unit_of_column(column: str) -> str | None:
    """Return the unit at the end of a column name (`stroke_mm` and `STROKE_MM` give `mm`), or None."""
    _, separator, suffix = column.rpartition("_")
    # A single letter in the other case may count: valve_a, side_N.
    unit = suffix if suffix in UNITS else SPELLINGS.get(suffix.lower()) if len(suffix) > 1 else None
    is_unit = separator and unit is not None and suffix.lower() in (unit.lower(), "pct")
    return unit if is_unit and unit not in NOT_COLUMN_SUFFIXES else None


def conversion_factor(unit: str, target: str, where: str) -> float:
    """Return the conversion factor from `unit` to `target`.

    Raises:
        InputError: a unit is unknown, or their dimensions differ.
    """
    source, wanted = UNITS[check_unit(unit, where)], UNITS[check_unit(target, where)]
    if source.dimension != wanted.dimension:
        raise InputError(
            f"{where}: '{unit}' is a unit of {source.dimension}, "
            f"expected one of {wanted.dimension} like '{target}'"
        )
    return 1.0 if unit == target else source.factor / wanted.factor
