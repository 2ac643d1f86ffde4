"""Role and unit of a column from its name and range."""

import re

from hitchid.data.signal_map import DIMENSIONS
from hitchid.data.units import UNITS, parse_unit, unit_of_column


def _list(text: str) -> frozenset[str]:
    return frozenset(text.split())


COMMAND = _list("cmd command duty pwm current curr valve strom ctrl control drive joystick rpm")
POSITION = _list(
    "position pos displacement stroke travel angle ang height length weg hub winkel lage extension"
)
NO_COMMAND = _list("feedback fb measured actual act ist ref reference setpoint target soll")
AXIS = _list("boom hitch lift lifting hub hubwerk kraftheber")
UP = _list("up raise lift lifting heben extend out rise auf")
DOWN = _list("down dn lower lowering senken retract in fall ab")
PRESSURE = _list("pressure press druck p")
LOADED_SIDE = _list("head cap bottom piston h load")
ANGLE = _list("angle ang winkel")
VALVE = _list("valve ventil solenoid sol coil magnet spule")
RATIO = _list("duty pwm percent pct ratio")
CURRENT = _list("current curr strom")
TIME = _list("time zeit timestamp zeitstempel uhrzeit stamp datetime date datum t")
ANALOG_V = 10.5  # V, range of a 10 V analogue input with 5 % margin
SERVO_NEUTRAL = (6.5, 8.5)  # percent, around 7.5: neutral pulse of a servo, 1.5 ms of 20 ms (limits chosen)


def words(name: str) -> frozenset[str]:
    """Return the words of a column's name, in lower case: boom, up, h, cyl, p for `Boom_UpH_Cyl_P`."""
    return frozenset(word.lower() for word in re.findall(r"[A-Z]?[a-zµ°%]+|[A-Z]+(?![a-z])", name))


def stated_unit(name: str, unit: str | None) -> tuple[str | None, str]:
    """Return the unit stated by the file or the column's name, or None, and its source."""
    if file_unit := parse_unit(unit or ""):
        return file_unit, "unit from the file"
    last = re.split(r"[^A-Za-z%°µ]+", name.strip(")] "))[-1]
    name_unit = unit_of_column(name) or (parse_unit(last) if len(last) > 1 and last != name else None)
    return name_unit, "unit from its name"


def unit_of(
    role: str, name: str, unit: str | None, largest: float, zero: float | None = None
) -> tuple[str, str]:
    """Return the unit of a signal and its source: the file, the name, or a guess from the range.

    Args:
        role: as in `[signals]`.
        name: of the column.
        unit: as spelled in the file.
        largest: largest absolute reading.
        zero: neutral reading of a command; for a servo, 1.5 ms in 20 ms are 7.5 percent.
    """
    stated, source = stated_unit(name, unit)
    if stated is not None and UNITS[stated].dimension in DIMENSIONS[role]:
        return stated, source
    name_words = words(name)
    if role == "displacement":
        guess = (
            "deg" if name_words & ANGLE else "V" if "position" in name_words and largest <= ANALOG_V else "mm"
        )
    elif name_words & RATIO:
        guess = "percent" if largest > 1.05 else "1"
    elif name_words & CURRENT or (name_words & VALVE and largest > 105):
        guess = "A" if largest <= 5 else "mA"
    elif zero is not None and SERVO_NEUTRAL[0] < zero < SERVO_NEUTRAL[1]:
        guess = "percent"
    elif largest > 105 and "rpm" in UNITS:
        guess = "rpm"
    else:
        guess = "1" if largest <= 1.05 else "V" if largest <= ANALOG_V else "percent"
    return guess, "unit guessed from name and range: check it"
