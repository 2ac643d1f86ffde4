"""Flags for inputs outside the ranges of the identification tests, sample by sample."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hitchid.data.record import COMMAND, DISPLACEMENT
from hitchid.model import Hitch

Range = tuple[float, float]


class _Covered(NamedTuple):
    """Dead zone, and lowest and highest effective command and displacement, of the tests of a direction.

    Attributes:
        texts: `command` and `displacement` to their ranges as text.
    """

    dead_zone: float
    command: Range
    displacement: Range
    texts: Mapping[str, str]


class RangeCheck:
    """Compares commands and displacement with those of the identification tests.

    It computes with Python's numbers: for single ones NumPy takes several times as long.

    Args:
        model: an identified hitch.
    """

    def __init__(self, model: Hitch) -> None:
        self._covered = {direction: _covered(model, direction) for direction in model.channels}

    def flags(self, sample: Mapping[str, float], mode: int) -> list[str]:
        """Return a sentence for each command outside its range, and for a displacement outside all of them.

        Args:
            sample: role to value, in the model's units; NaN where it is missing.
            mode: index of the active channel; −1 before any was active.
        """
        outside = []
        for direction, covered in self._covered.items():
            effective = max(abs(sample.get(COMMAND[direction], 0.0)) - covered.dead_zone, 0.0)
            lowest, highest = covered.command
            if effective > highest or 0 < effective < lowest:
                outside.append((COMMAND[direction], covered.texts["command"]))
        measured = sample.get(DISPLACEMENT, math.nan)
        directions = tuple(self._covered) if mode < 0 else tuple(self._covered)[mode : mode + 1]
        ranges = [self._covered[direction].displacement for direction in directions]
        if math.isfinite(measured) and not any(low <= measured <= high for low, high in ranges):
            outside.append((DISPLACEMENT, self._covered[directions[0]].texts[DISPLACEMENT]))
        return [f"outside: {role} {sample[role]:g}; the identified range is {text}" for role, text in outside]


def _covered(model: Hitch, direction: str) -> _Covered:
    channel = model.channels[direction]
    command, displacement = (
        (float(signal_range.lowest), float(signal_range.highest))
        for signal_range in (channel.operating_range.command, channel.operating_range.displacement)
    )
    # As the command that it is said of, not beyond the dead zone as it is kept.
    ends = " to ".join(f"{channel.dead_zone + end:.4g}" for end in command)
    texts = {
        "command": f"{ends} {model.units.get(COMMAND[direction], '')}",
        DISPLACEMENT: model.describe_range(direction, DISPLACEMENT),
    }
    return _Covered(channel.dead_zone, command, displacement, texts)
