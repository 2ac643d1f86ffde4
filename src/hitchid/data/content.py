"""Channels of one log with their units and clocks, as a file or a table in memory holds them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.short_repr import short_repr


@short_repr
class LogChannel(NamedTuple):
    """One channel as stored in a log.

    Attributes:
        values: shape [N], float64.
        unit: as written in the log; None if it has none.
        clock_s: time of each sample, s, shape [N]; None if the log has no clock for it. Channels on one
            clock share one array.
    """

    values: np.ndarray
    unit: str | None = None
    clock_s: np.ndarray | None = None


def _no_lines(_: int) -> int | None:
    return None


@short_repr
@dataclass(frozen=True)
class Content:
    """Channels read from one log.

    Attributes:
        source: the file, or the name of a table in memory.
        channels: each under its requested name; if all are selected, under its full name.
        notices: messages on what was converted, assumed or left out.
        line_of: from a sample to its line in the file, None for a format without lines.
    """

    source: Path | str
    channels: Mapping[str, LogChannel]
    notices: tuple[str, ...] = ()
    line_of: Callable[[int], int | None] = _no_lines

    @property
    def map_place(self) -> str:
        """Where the user writes the signal map, for messages."""
        return "campaign.toml" if isinstance(self.source, Path) else "signals"
