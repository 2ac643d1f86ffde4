"""What every reader is asked for, and what it hands over: channels of numbers, their units and clocks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid.errors import LogError

MAX_LISTED = 30
MAX_UNPACK_RATIO, ALWAYS_ALLOWED_BYTES = 200, 2**28
CHANNEL_HINT = "required it, or another named in campaign.toml"


class ChannelSelection(NamedTuple):
    """What is asked of a log.

    Attributes:
        time: channel that holds the time; not asked for where the file keeps a clock for each channel.
        signals: channels; None for all that hold numbers.
        databases: DBC files that say what is on a CAN bus.
    """

    time: str
    signals: tuple[str, ...] | None
    databases: tuple[Path, ...] = ()


class LogChannel(NamedTuple):
    """One channel as it stands in the file.

    Attributes:
        values: shape [N], float64.
        unit: as the file spells it, None where it says nothing.
        clock_s: time of each sample, s, shape [N]; None where the file keeps no clock for it. Channels on
            one clock share one array.
    """

    values: np.ndarray
    unit: str | None = None
    clock_s: np.ndarray | None = None


def max_unpacked_bytes(path: Path) -> int:
    """Return to how many bytes a file may unpack without being taken for a trap."""
    return max(ALWAYS_ALLOWED_BYTES, MAX_UNPACK_RATIO * path.stat().st_size)


def _no_lines(_: int) -> int | None:
    return None


@dataclass(frozen=True)
class Content:
    """What a reader hands over.

    Attributes:
        source: the file.
        channels: each under the name it was asked by; where all were, under its full name.
        notices: what the user should know of how they were read.
        line_of: from a sample to its line in the file, None where the format has no lines.
    """

    source: Path
    channels: Mapping[str, LogChannel]
    notices: tuple[str, ...] = ()
    line_of: Callable[[int], int | None] = _no_lines


def match_channels(
    source: Path, names: Sequence[str], selection: ChannelSelection, *, has_clocks: bool = False
) -> dict[str, str]:
    """Return the name each channel is asked by to its full name in the file.

    A full name is made of the groups it is in and its own, `group/channel`; what comes after the last stroke
    suffices where no other channel ends so.

    Args:
        source: the file.
        names: full names of the channels that hold numbers.
        selection: what is asked for.
        has_clocks: whether the file keeps a clock for each channel, so that the time may be missing, or be
            several: one in each group.

    Raises:
        LogError: a channel is not there, or several are meant.
    """
    if selection.signals is None:
        return {name: name for name in names}
    matches = {}
    for requested in dict.fromkeys((selection.time, *selection.signals)):
        candidates = (
            [requested]
            if requested in names
            else [name for name in names if name.rpartition("/")[2] == requested]
        )
        is_required = requested != selection.time or not has_clocks
        if len(candidates) > 1 and is_required:
            raise LogError(
                source, f"several channels are meant: {format_names(candidates)}", column=requested
            )
        if len(candidates) == 1:
            matches[requested] = candidates[0]
        elif is_required:
            raise LogError(
                source,
                f"there is no such channel; {CHANNEL_HINT}; found {format_names(names)}",
                column=requested,
            )
    _check_one_group(source, matches, selection.time)
    return matches


def _check_one_group(source: Path, matches: Mapping[str, str], time: str) -> None:
    """Refuse the time of one group for the channels of another, unless it is asked for by its full name."""
    group = matches.get(time, "").rpartition("/")[0]
    if not group or matches[time] == time:
        return
    for name in matches.values():
        if not name.startswith(f"{group}/"):
            problem = f"lies in another group than '{name}'; required its full name, '{matches[time]}'"
            raise LogError(source, problem, column=time)


def format_names(names: Sequence[str]) -> str:
    """Return names as a message lists them, of many the first thirty."""
    more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
    return (", ".join(names[:MAX_LISTED]) or "none with numbers") + more
