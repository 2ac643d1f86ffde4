"""Resampling of channels with several clocks onto the slowest of them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hitchid.data.content import LogChannel
from hitchid.data.record import COMMAND, LIFTING, resampled
from hitchid.data.resampling import GAP_FACTOR, unique_stamp_rows
from hitchid.errors import LogError

SIGNED_COMMAND = "command"  # role of one command for both directions
HOLD_ROLES = (SIGNED_COMMAND, *COMMAND.values())  # hold their last value between samples
CLOCK_TOLERANCE_S = 1e-9  # s; rounding of time stamps


def resample_to_common_clock(
    source: Path | str, time: LogChannel | None, channels: Mapping[str, LogChannel], names: Mapping[str, str]
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Return time stamps, s, every channel's samples at them, and notices.

    A channel that holds the time applies to all. Otherwise each channel has a clock of its own, and all are
    resampled onto the slowest: commands are held, other signals interpolated. Samples in a gap of any channel
    are left out; of samples with equal time stamps the first is kept.

    Args:
        source: the file, for messages.
        time: the channel that holds the time, s; None if the file has clocks.
        channels: role to channel.
        names: role to column, for messages.

    Raises:
        LogError: a channel has no clock, another length than the time, or time that decreases or is
            constant; or the channels have no time in common.
    """
    if time is not None:
        for role, channel in channels.items():
            if channel.values.size != time.values.size:
                raise LogError(
                    source,
                    f"has {channel.values.size} samples, expected {time.values.size} as the time",
                    column=names[role],
                )
            _check_agrees(source, time.values, channel, names[role])
        return time.values, {role: channel.values for role, channel in channels.items()}, []
    channels = {
        role: _with_increasing_clock(source, channel, names[role]) for role, channel in channels.items()
    }
    clocks = {role: channel.clock_s for role, channel in channels.items() if channel.clock_s is not None}
    steps = {role: float(np.median(np.diff(clock))) for role, clock in clocks.items()}
    slowest = max(steps, key=lambda role: steps[role])
    target = clocks[slowest]
    other_roles = {role for role, clock in clocks.items() if not np.array_equal(clock, target)}
    if not other_roles:
        return target, {role: channel.values for role, channel in channels.items()}, []
    mask = np.ones(target.size, dtype=bool)
    for role in other_roles:
        mask &= _is_covered(target, clocks[role], steps[slowest], extend_ends=role in HOLD_ROLES)
    if not mask.any():
        raise LogError(source, "the channels have no stretch of time in common")
    common_time_s = target[mask]
    sampled = {
        role: _resample(role, channel.values, clocks[role], common_time_s)
        if role in other_roles
        else channel.values[mask]
        for role, channel in channels.items()
    }
    steps_text = ", ".join(f"{names[role]} {steps[role]:.4g} s" for role in channels)
    return common_time_s, sampled, [f"merged on the clock of {names[slowest]}: {steps_text}"]


def _check_agrees(source: Path | str, time_s: np.ndarray, channel: LogChannel, name: str) -> None:
    """Refuse a time that lasts longer or shorter than the channel's own clock."""
    clock = channel.clock_s
    if clock is None or clock.size < 2:
        return
    clock_duration_s, time_duration_s = float(clock[-1] - clock[0]), float(time_s[-1] - time_s[0])
    if not abs(clock_duration_s - time_duration_s) <= abs(time_duration_s) / (clock.size - 1):
        problem = (
            f"lasts {clock_duration_s:g} s by its own clock, {time_duration_s:g} s by the time that is named"
        )
        raise LogError(source, f"{problem}; expected one that is its own", column=name)


def _with_increasing_clock(source: Path | str, channel: LogChannel, name: str) -> LogChannel:
    """Return a channel whose clock increases from sample to sample."""
    clock = channel.clock_s
    if clock is None:
        problem = 'has no clock in the file; expected the time\'s column: time = "…" in campaign.toml'
        raise LogError(source, problem, column=name)
    if clock.size < 2:
        raise LogError(source, f"has {clock.size} samples, expected at least 2", column=name)
    rows = unique_stamp_rows(clock, source, column=name, line_of=lambda _: None)
    if rows.size == clock.size:
        return channel
    return channel._replace(values=channel.values[rows], clock_s=clock[rows])


def _resample(
    role: str, samples: np.ndarray, source_time_s: np.ndarray, target_time_s: np.ndarray
) -> np.ndarray:
    resampling_role = COMMAND[LIFTING] if role == SIGNED_COMMAND else role
    return resampled({resampling_role: samples}, source_time_s, target_time_s)[resampling_role]


def _is_covered(target: np.ndarray, clock: np.ndarray, step_s: float, *, extend_ends: bool) -> np.ndarray:
    """Return where a channel has samples on both sides; `extend_ends` adds half a step at its ends; [N]."""
    slack = step_s / 2 if extend_ends else CLOCK_TOLERANCE_S
    after = np.clip(np.searchsorted(clock, target), 1, clock.size - 1)
    nearest_s = np.minimum(np.abs(target - clock[after]), np.abs(target - clock[after - 1]))
    without_gap = (clock[after] - clock[after - 1] <= GAP_FACTOR * step_s) | (nearest_s <= CLOCK_TOLERANCE_S)
    return without_gap & (target >= clock[0] - slack) & (target <= clock[-1] + slack)
