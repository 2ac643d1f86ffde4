"""How fast a piston that is held creeps."""

from collections.abc import Mapping, Sequence

import numpy as np

from hitchid.data.record import Record
from hitchid.data.test_kinds import directions

SETTLED_S = 0.5
SHORTEST_S = 0.5


def hold_drift(records: Sequence[Record], dead_zones: Mapping[str, float]) -> float:
    """Return the speed of a held piston, in the displacement's unit/s; zero where nothing is held.

    The slope that displacement has in common over all stretches without effective command, from 0.5 s after
    their start, of at least 0.5 s: least squares, each stretch with a level of its own.

    Args:
        records: tests of any kind.
        dead_zones: mode to dead zone, in the command's unit.
    """
    along = spread = 0.0
    for record in records:
        settled, shortest = round(SETTLED_S / record.step_s), round(SHORTEST_S / record.step_s)
        held = np.concatenate([[False], directions(record, dead_zones) == 0, [False]])
        edges = np.flatnonzero(np.diff(held.astype(np.int64)))
        for start, stop in zip(edges[::2] + settled, edges[1::2], strict=True):
            if stop - start >= shortest:
                time_s = record.time_s[start:stop] - record.time_s[start:stop].mean()
                along += float(time_s @ record.displacement[start:stop])
                spread += float(time_s @ time_s)
    return along / spread if spread else 0.0
