"""Levels of the command of strokes: a plant that changed and one that lacks oil differ only at several."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hitchid.adaptation.strokes import Stroke
from hitchid.data.record import DIRECTIONS
from hitchid.data.test_kinds import ACTIVE_FRACTION, effective_command
from hitchid.model import Channel

# Ratio of two commands beyond the dead zone at which a speed that does not follow the command (of a starved
# pump, or behind a flow divider) differs from a lower gain by more than strokes scatter; and the quantiles of
# the samples between which it is taken. Chosen.
LEVEL_RATIO = 1.2
LOW, HIGH = 0.1, 0.9


def levels_differ(channel: Channel, strokes: Sequence[Stroke]) -> bool:
    """Return whether the commands of strokes, in one or together, have levels that differ.

    Args:
        channel: as identified.
        strokes: of its direction.
    """
    active = np.concatenate([_active(channel, stroke) for stroke in strokes])
    if not active.size:
        return False
    low, high = np.quantile(active, [LOW, HIGH])
    return bool(high >= LEVEL_RATIO * low)


def level(channel: Channel, stroke: Stroke) -> float:
    """Return the median of a stroke's command beyond the dead zone, in its unit; 0 where it has none."""
    active = _active(channel, stroke)
    return float(np.median(active)) if active.size else 0.0


def _active(channel: Channel, stroke: Stroke) -> Float[np.ndarray, " n"]:
    """Return the command beyond the dead zone of the samples at which it is active."""
    column, highest = DIRECTIONS.index(channel.direction), float(channel.operating_range.command.highest)
    effective = np.abs(effective_command(stroke.commands[:, column], channel.dead_zone))
    return effective[effective > ACTIVE_FRACTION * highest]
