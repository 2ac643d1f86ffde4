"""Levels of the command of strokes: a plant that changed and one that lacks oil differ only at several."""

from collections.abc import Sequence

import numpy as np

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
    column, highest = DIRECTIONS.index(channel.direction), float(channel.operating_range.command.highest)
    commands = np.concatenate([stroke.commands[:, column] for stroke in strokes])
    effective = np.abs(effective_command(commands, channel.dead_zone))
    active = effective[effective > ACTIVE_FRACTION * highest]
    if not active.size:
        return False
    low, high = np.quantile(active, [LOW, HIGH])
    return bool(high >= LEVEL_RATIO * low)
