"""What every reader is asked for, and what it hands over: channels of numbers, their units and clocks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid.errors import LogError

SHOWN = 30
LARGEST_RATIO, UNSUSPICIOUS = 200, 2**28
OR_ELSE = "required it, or another named in campaign.toml"


class Wanted(NamedTuple):
    """What is asked of a log.

    Attributes:
        time: channel that holds the time; not asked for where the file keeps a clock for each channel.
        signals: channels; None for all that hold numbers.
        databases: DBC files that say what is on a CAN bus.
    """

    time: str
    signals: tuple[str, ...] | None
    databases: tuple[Path, ...] = ()


class Channel(NamedTuple):
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


def largest(path: Path) -> int:
    """Return to how many bytes a file may unpack without being taken for a trap."""
    return max(UNSUSPICIOUS, LARGEST_RATIO * path.stat().st_size)


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
    channels: Mapping[str, Channel]
    notices: tuple[str, ...] = ()
    line_of: Callable[[int], int | None] = _no_lines


def chosen(source: Path, names: Sequence[str], wanted: Wanted, *, clocked: bool = False) -> dict[str, str]:
    """Return the name each channel is asked by to its full name in the file.

    A full name is made of the groups it is in and its own, `group/channel`; what comes after the last stroke
    suffices where no other channel ends so.

    Args:
        source: the file.
        names: full names of the channels that hold numbers.
        wanted: what is asked for.
        clocked: whether the file keeps a clock for each channel, so that the time may be missing, or be
            several: one in each group.

    Raises:
        LogError: a channel is not there, or several are meant.
    """
    if wanted.signals is None:
        return {name: name for name in names}
    found = {}
    for asked in dict.fromkeys((wanted.time, *wanted.signals)):
        meant = [asked] if asked in names else [name for name in names if name.rpartition("/")[2] == asked]
        needed = asked != wanted.time or not clocked
        if len(meant) > 1 and needed:
            raise LogError(source, f"several channels are meant: {listed(meant)}", column=asked)
        if len(meant) == 1:
            found[asked] = meant[0]
        elif needed:
            raise LogError(
                source,
                f"there is no such channel; {OR_ELSE}; found {listed(names)}",
                column=asked,
            )
    _check_one_group(source, found, wanted.time)
    return found


def _check_one_group(source: Path, found: Mapping[str, str], time: str) -> None:
    """Refuse the time of one group for the channels of another, unless it is asked for by its full name."""
    group = found.get(time, "").rpartition("/")[0]
    if not group or found[time] == time:
        return
    for name in found.values():
        if not name.startswith(f"{group}/"):
            problem = f"lies in another group than '{name}'; required its full name, '{found[time]}'"
            raise LogError(source, problem, column=time)


def listed(names: Sequence[str]) -> str:
    """Return names as a message lists them, of many the first thirty."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (", ".join(names[:SHOWN]) or "none with numbers") + more
