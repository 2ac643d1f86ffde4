"""Quantities of a rig: base unit, admissible units and admissible range."""

import math
from typing import Any, NamedTuple

import equinox as eqx

from hitchid.errors import SettingsError
from hitchid.logs import UNITS

_LITRE = 1e-3  # m³
_MINUTE = 60.0  # s
_RPM = 2 * math.pi / _MINUTE  # rad/s
_BASE = {"current": "A", "ratio": "1", "length": "m", "angle": "rad", "pressure": "Pa", "time": "s"}

# Units that logs know as well have one factor for both; the others are of a rig alone.
FACTORS: dict[str, tuple[str, float]] = {
    **{name: (_BASE[unit.dimension], unit.factor) for name, unit in UNITS.items() if unit.dimension in _BASE},
    "m2": ("m2", 1.0),
    "mm2": ("m2", 1e-6),
    "m3": ("m3", 1.0),
    "L": ("m3", _LITRE),
    "m3/s": ("m3/s", 1.0),
    "L/min": ("m3/s", _LITRE / _MINUTE),
    "m3/(s·Pa)": ("m3/(s·Pa)", 1.0),
    "L/(min·MPa)": ("m3/(s·Pa)", _LITRE / _MINUTE * 1e-6),
    "1/Pa": ("1/Pa", 1.0),
    "1/MPa": ("1/Pa", 1e-6),
    "kg": ("kg", 1.0),
    "kg·m2": ("kg·m2", 1.0),
    "kg/m3": ("kg/m3", 1.0),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    "N/m": ("N/m", 1.0),
    "N·s/m": ("N·s/m", 1.0),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "s/m": ("s/m", 1.0),
    "rad/s": ("rad/s", 1.0),
    "Hz": ("rad/s", 2 * math.pi),
    "rpm": ("rad/s", _RPM),
    "degC": ("degC", 1.0),
    "1/K": ("1/K", 1.0),
}
"""Unit to its base unit and the factor from the one to the other."""


class QuantityRange(NamedTuple):
    """Base unit of a quantity, and the closed interval it must lie in, in that unit."""

    unit: str
    low: float
    high: float


def quantity(unit: str, low: float, high: float) -> Any:
    """Declare a field of a component: base unit, and limits in it; a scalar array inside jit."""
    return eqx.field(metadata={"range": QuantityRange(unit, low, high)})


def to_base_unit(value: float, unit: str, expected: QuantityRange, context: str) -> float:
    """Return a value in its base unit.

    Raises:
        SettingsError: the unit is unknown or of another dimension, or the value is out of range.
    """
    allowed_units = [name for name, (base, _) in FACTORS.items() if base == expected.unit]
    if unit not in allowed_units:
        raise SettingsError(
            f"{context}: got {value:g} {unit}, expected a unit among {', '.join(allowed_units)}"
        )
    converted = value * FACTORS[unit][1]
    if not expected.low <= converted <= expected.high:
        raise SettingsError(
            f"{context}: got {value:g} {unit}, expected {expected.low:g} to {expected.high:g} {expected.unit}"
        )
    return converted
