"""Drift of a held piston: its creep while neither direction is commanded."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid._support.metrics import better_on_held_out_tests
from hitchid.identification.dead_zone import slow_clock_factor
from hitchid.logs.kinds import direction_signs
from hitchid.logs.record import Record
from hitchid.model import TravelLimits

# s, at sampling times up to 0.1 s: time for lags of hydraulics to die away; shortest stretch with a slope.
SETTLED_S, SHORTEST_S = 0.5, 0.5
RESPONSES = 5  # times the model's response time to 63 %: e⁻⁵, less than 1 % of a speed is left then
AT_STOP_FRACTION = 0.01  # of the stroke; nearer to an end stop the piston lies on it and cannot move (chosen)
FEWEST_LOGS = 3  # to judge by logs; of fewer, single stretches are compared (chosen)


class Hold(NamedTuple):
    """Sums over a stretch in which the piston is held; x and t are measured from their means.

    Attributes:
        samples: how many.
        displacement_squares: Σx².
        products: Σt·x.
        time_squares: Σt².
    """

    samples: float
    displacement_squares: float
    products: float
    time_squares: float


def holds(
    records: Sequence[Record],
    dead_zones: Mapping[str, float],
    limits: TravelLimits | None = None,
    response_s: float = 0.0,
) -> list[list[Hold]]:
    """Return the stretches of each record without effective command, from where the piston has settled.

    That is 0.5 s (five samples at long sampling times) after their start, and five response times. They last
    at least as long. Left out: those at an end stop.
    """
    stops = [] if limits is None else [limits.lower] * limits.lower_stop + [limits.upper] * limits.upper_stop
    margin = 0.0 if limits is None else AT_STOP_FRACTION * (limits.upper - limits.lower)
    held = []
    for record in records:
        samples_per_s = slow_clock_factor(record.step_s) / record.step_s
        settling_samples, min_samples = round(SETTLED_S * samples_per_s), round(SHORTEST_S * samples_per_s)
        settling_samples = max(settling_samples, round(RESPONSES * response_s / record.step_s))
        is_held = np.concatenate([[False], direction_signs(record, dead_zones) == 0, [False]])
        edges = np.flatnonzero(np.diff(is_held.astype(np.int64)))
        stretches = []
        for start, stop in zip(edges[::2] + settling_samples, edges[1::2], strict=True):
            displacement = record.displacement[start:stop]
            if stop - start < min_samples or any(abs(displacement.mean() - at) <= margin for at in stops):
                continue
            time_s = record.time_s[start:stop] - record.time_s[start:stop].mean()
            way = displacement - displacement.mean()
            stretches.append(Hold(len(way), float(way @ way), float(time_s @ way), float(time_s @ time_s)))
        held.append(stretches)
    return held


def hold_drift(held: Iterable[Iterable[Hold]]) -> float:
    """Return the speed of a held piston, in the displacement's unit/s; zero where nothing is held.

    The slope that displacement has in common over all stretches: least squares, each with a level of its own.
    """
    stretches = [stretch for of_record in held for stretch in of_record]
    time_squares = sum(stretch.time_squares for stretch in stretches)
    return sum(stretch.products for stretch in stretches) / time_squares if time_squares else 0.0


def drift_is_shown(held: Sequence[Sequence[Hold]]) -> bool:
    """Return whether the drift that other logs have in common describes how each log's held piston moves.

    It must be better than rest on logs that are left out in turn: see `better_on_held_out_tests`.
    """
    groups = [stretches for stretches in held if stretches]
    if len(groups) < FEWEST_LOGS:
        groups = [[stretch] for stretches in groups for stretch in stretches]
    if len(groups) < 2:
        return False
    samples, squares, products, times = np.array([np.sum(group, axis=0) for group in groups]).T
    others = (products.sum() - products) / (times.sum() - times)
    remaining = np.maximum(squares - 2 * others * products + others**2 * times, 0.0)
    return better_on_held_out_tests(np.sqrt(remaining / samples), np.sqrt(squares / samples))
