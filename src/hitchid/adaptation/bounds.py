"""How far and how fast the parameters of a channel may change."""

import contextlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.parameters import DEAD_ZONE, LAG, NAMES, Changes, has_lag
from hitchid.adaptation.settings import AdaptationSettings
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model import Channel

MOST_DEAD_ZONE_A = 0.15  # A: change of a dead zone, whatever the range of the current is; chosen
LARGEST_LAG = 1.6  # change of the log lag: a factor of five, as oil from 5 to 50 °C has; chosen
LAG_SCATTER, LAG_DRIFT = 0.1, 0.02  # of the log lag, as the settings have for the others; chosen


@short_repr
class Bounds(NamedTuple):
    """Bounds and scales of the changes of one channel: log gain, dead zone, log lag, shape [3] each.

    Attributes:
        allowed: which parameters may change.
        lowest, highest: changes since the identification.
        step: largest change from one stroke of the machine to the next.
        scatter: standard deviation from stroke to stroke.
        drift: standard deviation by which they wander from stroke to stroke.
    """

    allowed: Bool[np.ndarray, "3"]
    lowest: Float[np.ndarray, "3"]
    highest: Float[np.ndarray, "3"]
    step: Float[np.ndarray, "3"]
    scatter: Float[np.ndarray, "3"]
    drift: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, channel: Channel, settings: AdaptationSettings, command_unit: str) -> "Bounds":
        """Return the bounds of a channel; shares of the command are of the largest one of its tests."""
        command = float(channel.operating_range.command.highest)
        allowed = np.array([name in settings.parameters for name in NAMES])
        allowed[LAG] &= has_lag(channel)
        dead_zone = settings.largest_dead_zone * command
        with contextlib.suppress(InputError):  # a command that is no current
            dead_zone = min(dead_zone, MOST_DEAD_ZONE_A * conversion_factor("A", command_unit, "dead_zone"))
        lowest = np.array([np.log1p(-settings.largest_gain), -dead_zone, -LARGEST_LAG])
        lowest[DEAD_ZONE] = max(lowest[DEAD_ZONE], -channel.dead_zone)
        step = settings.change_per_stroke
        return cls(
            allowed,
            lowest,
            np.array([np.log1p(settings.largest_gain), dead_zone, LARGEST_LAG]),
            np.array([np.log1p(step), step * command, step]),
            np.array([settings.gain_scatter, settings.dead_zone_scatter * command, LAG_SCATTER]),
            np.array([settings.gain_drift, settings.dead_zone_drift * command, LAG_DRIFT]),
        )

    def beyond(self, changes: Float[np.ndarray, "3"]) -> str:
        """Return the name of a parameter that is outside its bounds; empty for none."""
        outside = (changes < self.lowest) | (changes > self.highest)
        return NAMES[int(np.argmax(outside))].replace("_", " ") if outside.any() else ""

    def clipped(self, changes: Float[np.ndarray, "3"]) -> Changes:
        """Return changes within the bounds."""
        return Changes(*map(float, np.clip(changes, self.lowest, self.highest)))

    def towards(self, deployed: Changes, target: Changes) -> Changes:
        """Return the changes in use one step nearer to others; these themselves where they are that near."""
        way = np.subtract(target, deployed)
        if np.all(np.abs(way) <= self.step):
            return target
        return Changes(*map(float, np.add(deployed, np.clip(way, -self.step, self.step))))
