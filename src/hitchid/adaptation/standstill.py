"""Standstill between two strokes: a jump of the displacement is a fault, a slow change a leak."""

import math
from typing import NamedTuple

import numpy as np

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.gates import REST_SHARE
from hitchid.adaptation.strokes import LONGEST_S, SETTLE_S, Stroke
from hitchid.model import Hitch
from hitchid.structures.batch import REST_SAMPLES

LARGEST_AT_REST = 0.05  # share of the range of the tests that a piston at rest moves within a second; chosen
LARGEST_CREEP = 0.02  # of that for each second of a pause: an implement sinks; chosen
SHORTEST_S = 10.0  # s of a standstill that shows a leak, not the end of the motion before it; chosen


@short_repr
class Standstill(NamedTuple):
    """What the displacement does between two strokes.

    Attributes:
        seconds: of it, s.
        change: of the displacement over it, between medians of samples at rest, in the model's unit.
        change_at_end: the same to the last sample before the command.
        deviation: standard deviation of the change, of noise and of what is not at rest yet.
    """

    seconds: float
    change: float
    change_at_end: float
    deviation: float

    @property
    def leak(self) -> dict[str, float]:
        """Speed of the held piston and its standard deviation, in its unit/s; none of a short standstill."""
        if self.seconds < SHORTEST_S:
            return {}
        return {"leak": self.change / self.seconds, "leak_deviation": self.deviation / self.seconds}

    def fault(self, model: Hitch) -> str:
        """Return why the displacement cannot be that of a piston at rest; empty where it can.

        Args:
            model: as identified, whose held piston moves by `drift`.
        """
        largest = LARGEST_AT_REST * _range_of_tests(model) * (1 + LARGEST_CREEP * self.seconds)
        moved = self.change_at_end - model.drift * self.seconds
        return (
            f"the displacement changed by {moved:+.3g} at rest: sensor or implement"
            if abs(moved) > largest
            else ""
        )


def rested_at(stroke: Stroke, step_s: float) -> float:
    """Return where the piston is at rest after a stroke; NaN where that is not in it."""
    rested = stroke.displacement[-_samples(step_s) :]
    rested = rested[np.isfinite(rested)]
    if not rested.size or len(stroke.displacement) >= round(LONGEST_S / step_s):
        return math.nan
    return float(np.median(rested))


def standstill_before(model: Hitch, stroke: Stroke, ended_at: int, rested: float) -> Standstill | None:
    """Return the standstill before a stroke; None where it was not seen.

    Args:
        model: as identified.
        stroke: after it.
        ended_at: number of the sample at which the stroke before ended.
        rested: displacement there; NaN where it is not known.
    """
    before = stroke.displacement[: stroke.rest]
    before = before[np.isfinite(before)]
    if not before.size or math.isnan(rested):
        return None
    samples = _samples(model.step_s)
    noise = max(float(channel.load_filter.noise) for channel in model.channels.values())
    # A median of n normal variables has the variance π/2 σ²/n.
    deviation = np.hypot(noise * np.sqrt(np.pi / samples), REST_SHARE * _range_of_tests(model))
    return Standstill(
        max(stroke.begin - ended_at, 0) * model.step_s,
        float(np.median(before[-samples:])) - rested,
        float(before[-1]) - rested,
        float(deviation),
    )


def _samples(step_s: float) -> int:
    """Return how many samples show where the piston is at rest."""
    return min(REST_SAMPLES // 5, max(1, round(SETTLE_S / step_s)))


def _range_of_tests(model: Hitch) -> float:
    ranges = [each.operating_range.displacement for each in model.channels.values()]
    return max(float(each.highest) - float(each.lowest) for each in ranges)
