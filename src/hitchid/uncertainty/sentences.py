"""Operating characteristics in plain words."""

from hitchid.uncertainty.characteristics import Characteristics
from hitchid.uncertainty.estimate import Interval, Quantity
from hitchid.uncertainty.words import interval_text

VERBS = {"lifting": "lifts", "lowering": "lowers"}


def characteristic_sentences(known: Characteristics, mode: str) -> tuple[str, ...]:
    """Return dead zone, speeds and times of one direction in plain words, a sentence each.

    Of several loads the middle one is told.

    Args:
        known: the characteristics.
        mode: lifting or lowering.
    """
    unit, begins = known.command_unit, known.opening
    said = [
        f"flow begins at {_told(begins, unit)}" if begins else f"dead zone {_told(known.dead_zone, unit)}"
    ]
    loads = sorted({point.load for point in known.speed_map if point.load is not None})
    middle = loads[len(loads) // 2] if loads else None
    speeds = [
        _value(point.speed, known.speed_unit, point.interval, determined=point.determined)
        + f" at {point.command:.3g} {unit}"
        for point in known.speed_map
        if point.load == middle
    ]
    under = f", with {known.load} {middle:.4g}" if middle is not None else ""
    said.append(f"the piston {VERBS[mode]} at mid stroke{under}: {'; '.join(speeds)}")
    if known.delay is not None and known.response_time is not None:
        said.append(
            f"after a step to {known.level:.3g} {unit} motion begins (5 % of the speed) after "
            f"{_told(known.delay, 's')} and has 63 % of its speed after {_told(known.response_time, 's')}"
        )
    return tuple(said)


def _told(known: Quantity, unit: str) -> str:
    return _value(known.value, unit, known.interval, determined=known.determined)


def _value(value: float, unit: str, interval: Interval, *, determined: bool) -> str:
    if interval == (value, value):
        return f"{value:.3g} {unit}"
    doubt = "" if determined else ", not determined"
    return f"{value:.3g} {unit} ({interval_text(interval)}{doubt})"
