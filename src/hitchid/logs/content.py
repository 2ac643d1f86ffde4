"""Channels of one log with their units and clocks, as a file or a table in memory holds them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.records import short_repr
from hitchid.errors import LogError

# Argument of every reader: the selected channels, and how their names match those in the file.

MAX_LISTED = 30  # names in one message
# Limits of unpacked logs: bytes a byte of the file, and a size that is always allowed, bytes; chosen.
MAX_UNPACK_RATIO, ALWAYS_ALLOWED_BYTES = 200, 2**28


@short_repr
class ChannelSelection(NamedTuple):
    """The channels to read from a log.

    Attributes:
        time: channel that holds the time; optional in a file with a clock for each channel.
        signals: channels; None for all that hold numbers.
        databases: DBC files, which define the messages of a CAN bus.
    """

    time: str
    signals: tuple[str, ...] | None
    databases: tuple[Path, ...] = ()


def max_unpacked_bytes(path: Path) -> int:
    """Return the largest size, bytes, to which a file may unpack."""
    return max(ALWAYS_ALLOWED_BYTES, MAX_UNPACK_RATIO * path.stat().st_size)


def match_channels(
    source: Path, names: Sequence[str], selection: ChannelSelection, *, has_clocks: bool = False
) -> dict[str, str]:
    """Return requested name to full name in the file.

    A full name is the names of the groups and the channel, `group/channel`; the part after the last slash
    suffices if it is unique.

    Args:
        source: the file.
        names: full names of the channels that hold numbers.
        selection: the requested channels.
        has_clocks: whether the file has a clock for each channel; the time may then be missing, or be in
            several groups.

    Raises:
        LogError: a channel is missing or ambiguous.
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
            problem = f"several channels have this name; use the full name: {format_names(candidates)}"
            raise LogError(source, problem, column=requested)
        if len(candidates) == 1:
            matches[requested] = candidates[0]
        elif is_required:
            raise no_such_channel(source, requested, names)
    # The time of one group says nothing about channels of another, unless its full name is requested.
    time = matches.get(selection.time, "")
    group = time.rpartition("/")[0]
    for name in matches.values() if group and time != selection.time else ():
        if not name.startswith(f"{group}/"):
            problem = f"is in another group than '{name}'; use its full name, '{time}'"
            raise LogError(source, problem, column=selection.time)
    return matches


def no_such_channel(
    source: Path, requested: str, names: Sequence[str], *, kind: str = "channel", line: int | None = None
) -> LogError:
    """Return the error for a channel or column that a log does not have, with those it has."""
    problem = (
        f"there is no such {kind}; name it in campaign.toml, as `hitchid inspect {source.parent} --propose` "
        f"proposes; found {format_names(names)}"
    )
    return LogError(source, problem, line=line, column=requested)


def format_names(names: Sequence[str]) -> str:
    """Return the first names for a message, and how many more there are."""
    more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
    return (", ".join(names[:MAX_LISTED]) or "none with numbers") + more


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
    line_of: Callable[[int], int | None] = lambda _: None
