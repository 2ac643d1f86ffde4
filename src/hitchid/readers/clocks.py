"""Several time bases in one file, taken to the slowest of them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hitchid.data.record import COMMAND, LIFTING, resampled
from hitchid.data.resampling import GAP, first_of_each_stamp
from hitchid.errors import LogError
from hitchid.readers.content import Channel

SIGNED = "command"
HELD = (SIGNED, *COMMAND.values())
SAME_S = 1e-9


def on_one_clock(
    source: Path, time: Channel | None, channels: Mapping[str, Channel], names: Mapping[str, str]
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Return time stamps, s, and every channel's samples at them, and what was done.

    Where a channel holds the time, it counts for all. Else each channel has a clock of its own, and all are
    taken to the slowest: commands as they are in force, everything else interpolated. What falls into a gap
    of some channel is left out; of samples with one time stamp the first is kept.

    Args:
        source: the file, for messages.
        time: the channel that holds the time, s; None where the file keeps clocks.
        channels: role to channel.
        names: role to column, for messages.

    Raises:
        LogError: a channel has no clock, another length than the time, or time that runs backwards or stands
            still; or the channels have no time in common.
    """
    if time is not None:
        for role, channel in channels.items():
            if channel.values.size != time.values.size:
                raise LogError(
                    source,
                    f"has {channel.values.size} samples, required {time.values.size} as the time",
                    column=names[role],
                )
            _check_agrees(source, time.values, channel, names[role])
        return time.values, {role: channel.values for role, channel in channels.items()}, []
    channels = {role: _clocked(source, channel, names[role]) for role, channel in channels.items()}
    clocks = {role: channel.clock_s for role, channel in channels.items() if channel.clock_s is not None}
    steps = {role: float(np.median(np.diff(clock))) for role, clock in clocks.items()}
    slowest = max(steps, key=lambda role: steps[role])
    target = clocks[slowest]
    others = {role for role, clock in clocks.items() if not np.array_equal(clock, target)}
    if not others:
        return target, {role: channel.values for role, channel in channels.items()}, []
    kept = np.ones(target.size, dtype=bool)
    for role in others:
        kept &= _covered(target, clocks[role], steps[slowest], beyond=role in HELD)
    if not kept.any():
        raise LogError(source, "the channels have no stretch of time in common")
    at = target[kept]
    sampled = {
        role: _sampled(role, channel.values, clocks[role], at) if role in others else channel.values[kept]
        for role, channel in channels.items()
    }
    told = ", ".join(f"{names[role]} {steps[role]:.4g} s" for role in channels)
    return at, sampled, [f"merged on the clock of {names[slowest]}: {told}"]


def _check_agrees(source: Path, time_s: np.ndarray, channel: Channel, name: str) -> None:
    """Refuse a time for a channel whose own clock runs otherwise: one of the two is not of this channel."""
    clock = channel.clock_s
    if clock is None or clock.size < 2:
        return
    lasting, said = float(clock[-1] - clock[0]), float(time_s[-1] - time_s[0])
    if not abs(lasting - said) <= abs(said) / (clock.size - 1):
        problem = f"lasts {lasting:g} s by its own clock, {said:g} s by the time that is named"
        raise LogError(source, f"{problem}; required one that is its own", column=name)


def _clocked(source: Path, channel: Channel, name: str) -> Channel:
    """Return a channel whose clock increases from sample to sample."""
    clock = channel.clock_s
    if clock is None:
        problem = 'the file keeps no clock for it; required the time\'s column: time = "…" in campaign.toml'
        raise LogError(source, problem, column=name)
    if clock.size < 2:
        raise LogError(source, f"has {clock.size} samples, required at least 2", column=name)
    rows = first_of_each_stamp(clock, source, column=name, line_of=lambda _: None)
    if rows.size == clock.size:
        return channel
    return channel._replace(values=channel.values[rows], clock_s=clock[rows])


def _sampled(role: str, samples: np.ndarray, had_s: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    known = COMMAND[LIFTING] if role == SIGNED else role
    return resampled({known: samples}, had_s, wanted_s)[known]


def _covered(target: np.ndarray, clock: np.ndarray, step_s: float, *, beyond: bool) -> np.ndarray:
    """Tell when a channel has samples around, or up to half a step `beyond` its ends, shape [N]."""
    slack = step_s / 2 if beyond else SAME_S
    after = np.clip(np.searchsorted(clock, target), 1, clock.size - 1)
    near = np.minimum(np.abs(target - clock[after]), np.abs(target - clock[after - 1]))
    whole = (clock[after] - clock[after - 1] <= GAP * step_s) | (near <= SAME_S)
    return whole & (target >= clock[0] - slack) & (target <= clock[-1] + slack)
