"""Operating characteristics as sentences."""

from hitchid.model import Characteristics, Interval, Quantity
from hitchid.report import numbers

VERBS = {"lifting": "lifts", "lowering": "lowers"}


def characteristic_sentences(characteristics: Characteristics, direction: str) -> tuple[str, ...]:
    """Return dead zone, speeds and times of one direction, one sentence each, at the middle load.

    Args:
        characteristics: operating characteristics of the direction.
        direction: lifting or lowering.
    """
    unit, opening = characteristics.command_unit, characteristics.opening
    sentences = [
        f"flow begins at {_quantity_text(opening, unit)}"
        if opening
        else f"dead zone {_quantity_text(characteristics.dead_zone, unit)}"
    ]
    loads = sorted({point.load for point in characteristics.speed_map if point.load is not None})
    middle = loads[len(loads) // 2] if loads else None
    speeds = [
        _value_text(point.speed, characteristics.speed_unit, point.interval, determined=point.determined)
        + f" at {point.command:.3g} {unit}"
        for point in characteristics.speed_map
        if point.load == middle
    ]
    load_phrase = f", with {characteristics.load} {middle:.4g}" if middle is not None else ""
    sentences.append(f"the piston {VERBS[direction]} at mid stroke{load_phrase}: {'; '.join(speeds)}")
    if characteristics.delay is not None and characteristics.response_time is not None:
        sentences.append(
            f"after a step to {characteristics.level:.3g} {unit} motion starts (5 % of the speed) after "
            f"{_quantity_text(characteristics.delay, 's')} and reaches 63 % of its speed after "
            f"{_quantity_text(characteristics.response_time, 's')}"
        )
    return tuple(sentences)


def _quantity_text(quantity: Quantity, unit: str) -> str:
    return _value_text(quantity.value, unit, quantity.interval, determined=quantity.determined)


def _value_text(value: float, unit: str, interval: Interval, *, determined: bool) -> str:
    if interval == (value, value):
        return f"{value:.3g} {unit}"
    caveat = "" if determined else ", not determined"
    return f"{value:.3g} {unit} ({numbers.interval(interval)}{caveat})"
