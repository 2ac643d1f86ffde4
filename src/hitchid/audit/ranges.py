"""Whether the numbers of a signal are possible in the unit it is said to be in."""

from collections.abc import Callable
from math import pi
from typing import NamedTuple

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Survey
from hitchid.data.record import COMMAND, DISPLACEMENT
from hitchid.data.units import UNITS


class _Range(NamedTuple):
    """Lowest and highest number of a signal in all logs, and its unit."""

    lowest: float
    highest: float
    unit: str

    @property
    def largest(self) -> float:
        return max(abs(self.lowest), abs(self.highest))

    @property
    def reach(self) -> float:
        return self.highest - self.lowest

    @property
    def si(self) -> float:
        """Factor to the SI unit."""
        return UNITS[self.unit].factor


class _Doubt(NamedTuple):
    """What makes a range doubtful, and what it probably is."""

    dimension: str
    applies: Callable[[_Range], bool]
    level: Level
    probably: str


LONGEST_M = 20.0
SHORTEST_M = 1e-3
LARGEST_CURRENT_A = 20.0
SMALLEST_MILLIAMPERE = 5.0
LARGEST_PRESSURE_PA = 1000e5
LOWEST_PRESSURE_PA = -2e5
LARGEST_VOLTAGE_V = 100.0
OVERDRIVE = 1.05

_POSITION = (
    _Doubt("length", lambda r: r.reach * r.si > LONGEST_M, Level.FAULT, "a smaller unit, such as mm"),
    _Doubt(
        "length",
        lambda r: 0 < r.reach * r.si < SHORTEST_M,
        Level.WARNING,
        "a larger unit, such as m, or a piston that hardly moves",
    ),
)
_ANGLE = (
    _Doubt("angle", lambda r: r.unit == "rad" and r.largest > 2 * pi, Level.WARNING, "degrees"),
    _Doubt(
        "angle",
        lambda r: r.unit == "deg" and r.largest > 360.0,
        Level.WARNING,
        "a raw count, or an encoder that ran over",
    ),
    _Doubt("angle", lambda r: r.unit == "deg" and 0 < r.largest <= 2 * pi, Level.NOTE, "radians"),
)
_RATIO = (
    _Doubt("ratio", lambda r: r.unit == "1" and r.largest > OVERDRIVE, Level.WARNING, "percent"),
    _Doubt(
        "ratio",
        lambda r: r.unit == "percent" and r.largest > 100 * OVERDRIVE,
        Level.WARNING,
        "a raw count, not percent",
    ),
    _Doubt(
        "ratio",
        lambda r: r.unit == "percent" and 0 < r.largest <= 1,
        Level.WARNING,
        "a fraction, in unit 1",
    ),
)
_ELECTRIC = (
    _Doubt("current", lambda r: r.unit == "A" and r.largest > LARGEST_CURRENT_A, Level.FAULT, "mA"),
    _Doubt(
        "current",
        lambda r: r.unit == "mA" and 0 < r.largest <= SMALLEST_MILLIAMPERE,
        Level.WARNING,
        "A",
    ),
    _Doubt("voltage", lambda r: r.largest > LARGEST_VOLTAGE_V, Level.WARNING, "mV"),
)
_PRESSURE = (
    _Doubt(
        "pressure",
        lambda r: r.highest * r.si > LARGEST_PRESSURE_PA or r.lowest * r.si < LOWEST_PRESSURE_PA,
        Level.WARNING,
        "another unit of pressure, or the zero of the sensor is off",
    ),
)
DOUBTS = (*_POSITION, *_ANGLE, *_RATIO, *_ELECTRIC, *_PRESSURE)


def units(survey: Survey) -> list[AuditFinding]:
    """Find signals whose range over all logs is not plausible in their unit; nothing is ever converted.

    The limits: no lifting cylinder strokes 20 m, none is worth a model below 1 mm; a valve's coil takes a few
    A, so above 20 A it is mA, and what never exceeds 5 mA drives no valve; a joint turns within ±360°; a
    ratio ends at 1 and 100 percent, 5 % of overdrive allowed; hydraulics end at 1000 bar, and 2 bar below
    zero is a sensor's offset; benches have no signals beyond 100 V. Impossible is a fault, unlikely a
    warning. A further measured signal in unit 1 mostly was given no unit at all: a note.
    """
    found = []
    roles = dict.fromkeys(role for look in survey.looks for role in look.record.signals)
    for role in roles:
        given = _range(survey, role)
        further = role != DISPLACEMENT and role not in COMMAND.values()
        for doubt in DOUBTS:
            if doubt.dimension != UNITS[given.unit].dimension or not doubt.applies(given):
                continue
            if further and doubt.dimension in ("length", "ratio"):
                continue  # a further signal may be small, or have come without a unit
            found.append(_finding(role, given, doubt.level, f"this is probably {doubt.probably}"))
        if further and given.unit == "1" and given.largest > OVERDRIVE:
            found.append(_finding(role, given, Level.NOTE, "so its unit is not told"))
    return found


def _range(survey: Survey, role: str) -> _Range:
    present = [look.record for look in survey.looks if role in look.record.signals]
    arrays = [record.signals[role] for record in present]
    return _Range(
        float(min(each.min() for each in arrays)),
        float(max(each.max() for each in arrays)),
        present[0].units[role],
    )


def _finding(role: str, given: _Range, level: Level, judgement: str) -> AuditFinding:
    what = (
        f"{role} runs from {given.lowest:.4g} to {given.highest:.4g} over all logs "
        f"and is said to be in unit '{given.unit}': {judgement}"
    )
    return AuditFinding(
        "units",
        level,
        "",
        role,
        (),
        what,
        "check the unit of this column in campaign.toml; nothing is converted",
    )
