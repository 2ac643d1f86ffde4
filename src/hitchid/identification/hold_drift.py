"""Drift of a held piston."""

from collections.abc import Mapping, Sequence

import numpy as np

from hitchid.data.record import Record
from hitchid.data.test_kinds import direction_signs
from hitchid.identification.dead_zone import slow_clock_factor

# s, at sampling times up to 0.1 s: time for lags of hydraulics to die away; shortest stretch with a slope.
SETTLED_S, SHORTEST_S = 0.5, 0.5


def hold_drift(records: Sequence[Record], dead_zones: Mapping[str, float]) -> float:
    """Return the speed of a held piston, in the displacement's unit/s; zero where nothing is held.

    The slope that displacement has in common over all stretches without effective command, from 0.5 s after
    their start, of at least 0.5 s (five samples at long sampling times): least squares, each stretch with a
    level of its own.

    Args:
        records: tests of any kind.
        dead_zones: direction to dead zone, in the command's unit.
    """
    sum_time_displacement = sum_time_squared = 0.0
    for record in records:
        samples_per_s = slow_clock_factor(record.step_s) / record.step_s
        settling_samples, min_samples = round(SETTLED_S * samples_per_s), round(SHORTEST_S * samples_per_s)
        is_held = np.concatenate([[False], direction_signs(record, dead_zones) == 0, [False]])
        edges = np.flatnonzero(np.diff(is_held.astype(np.int64)))
        for start, stop in zip(edges[::2] + settling_samples, edges[1::2], strict=True):
            if stop - start >= min_samples:
                time_s = record.time_s[start:stop] - record.time_s[start:stop].mean()
                sum_time_displacement += float(time_s @ record.displacement[start:stop])
                sum_time_squared += float(time_s @ time_s)
    return sum_time_displacement / sum_time_squared if sum_time_squared else 0.0
