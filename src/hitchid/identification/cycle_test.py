"""Test of the compensators for free run on whole cycles, where each continues where the other one ended."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchid.data.record import Record
from hitchid.model import Hitch


def without_speed_compensators(hitch: Hitch) -> Hitch:
    """Return a hitch whose free runs are those of the benchmarks."""
    channels = {
        direction: replace(channel, speed_compensator=None) for direction, channel in hitch.channels.items()
    }
    return replace(hitch, channels=channels)


def cycle_errors(hitch: Hitch, cycles: Sequence[Record]) -> tuple[float, float]:
    """Return the free-run RMSE over whole cycles of a hitch, and of it without compensators for free run.

    Each cycle has the same weight; in the displacement's unit.
    """

    def rmse(hitch: Hitch) -> float:
        squares = [np.mean((hitch.simulate(each).displacement - each.displacement) ** 2) for each in cycles]
        return float(np.sqrt(np.mean(squares)))

    return rmse(hitch), rmse(without_speed_compensators(hitch))
