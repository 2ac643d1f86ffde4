"""Static test: dead zone and speed of a direction from slow ramps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hitchid.data.record import LIFTING, Record
from hitchid.identification.dead_zone import from_ramps

RAMP_TRAVEL_M = 0.02  # m, travel at which a ramp ends (chosen, as an operator would end it)
RAMP_TAIL_S = 1.0  # s, end of a ramp used for its speed (chosen)


@dataclass(frozen=True)
class StaticResult:
    """Result of the static test of one direction.

    Attributes:
        dead_zone: mean over the ramps, A.
        speed_per_command: speed at the end of the ramps over the effective command there, mm/(s·A).
    """

    dead_zone: float
    speed_per_command: float


def evaluate_ramps(ramps: Sequence[Record], direction: str) -> StaticResult:
    """Return the result of the ramps of one direction (Sun et al. 2025, sec. 2.3.1).

    Args:
        ramps: at least one; displacement in mm, command in A.
        direction: lifting or lowering.

    Raises:
        LogError: a ramp ends before the piston moves.
    """
    sign = 1 if direction == LIFTING else -1
    zone = from_ramps(ramps, direction, sign).value
    tail = slice(-round(RAMP_TAIL_S / ramps[0].step_s), None)
    speeds = [sign * np.polyfit(ramp.time_s[tail], ramp.displacement[tail], 1)[0] for ramp in ramps]
    effective = np.mean([ramp.command(direction)[tail].mean() - zone for ramp in ramps])
    return StaticResult(zone, float(np.mean(speeds) / effective))
