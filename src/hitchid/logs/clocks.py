"""Resampling of channels with several clocks onto one of them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hitchid.errors import LogError
from hitchid.logs.content import LogChannel
from hitchid.logs.record import COMMAND, DISPLACEMENT, LIFTING, resampled
from hitchid.logs.resampling import GAP_FACTOR, one_sample_a_stamp, unique_stamp_rows

SIGNED_COMMAND = "command"  # role of one command for both directions
HOLD_ROLES = (SIGNED_COMMAND, *COMMAND.values())  # hold their last value between samples
CLOCK_TOLERANCE_S = 1e-9  # s; rounding of time stamps
SLOWEST_COMMAND = 10.0  # sampling times of the displacement; a slower command is held (chosen)
ON_CHANGE_STEPS = 3.0  # of the displacement; a channel logged on change is rarer (chosen)
# Of its intervals, longer or shorter than their median by a factor of 1.5: no clock, even with gaps (chosen).
ON_CHANGE_QUANTILE = 0.9


def resample_to_common_clock(
    source: Path | str, time: LogChannel | None, channels: Mapping[str, LogChannel], names: Mapping[str, str]
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Return time stamps, s, every channel's samples at them, and notices.

    A channel that holds the time applies to all. Otherwise each channel has a clock of its own, and all come
    to the slowest of the displacement and the commands; not counted are commands that are logged on change,
    or more than ten times slower than the displacement. Commands and what is logged on change are held, other
    signals interpolated. Samples in a gap of any channel are left out. Of samples with one time stamp a
    command takes the last, another signal the one nearest to the line through its neighbours.

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
        role: _with_increasing_clock(source, role, channel, names[role]) for role, channel in channels.items()
    }
    clocks = {role: channel.clock_s for role, channel in channels.items() if channel.clock_s is not None}
    steps = {role: float(np.median(np.diff(clock))) for role, clock in clocks.items()}
    measured_step_s = steps.get(DISPLACEMENT, min(steps.values()))
    held = {
        role
        for role, channel in channels.items()
        if role != DISPLACEMENT and _is_logged_on_change(role, channel.values, clocks[role], measured_step_s)
    }
    # What is rare beside the motion, such as an oil temperature, says nothing about how well it was sampled.
    deciding = [
        role
        for role in (DISPLACEMENT, *HOLD_ROLES)
        if role in clocks and role not in held and steps[role] <= SLOWEST_COMMAND * measured_step_s
    ]
    reference = (
        max(deciding, key=lambda role: steps[role]) if deciding else min(steps, key=lambda r: steps[r])
    )
    target = clocks[reference]
    other_roles = {role for role, clock in clocks.items() if not np.array_equal(clock, target)}
    if not other_roles:
        return target, {role: channel.values for role, channel in channels.items()}, []
    mask = np.ones(target.size, dtype=bool)
    for role in other_roles:
        step_s = max(steps[role], steps[reference])
        # Motion is not made up beyond its samples; a slow covariate hardly changes within one of its steps.
        is_slow = steps[role] > steps[reference]
        slack_s = step_s / 2 if role in HOLD_ROLES else step_s if is_slow else CLOCK_TOLERANCE_S
        mask &= _is_covered(
            target,
            clocks[role],
            longest_s=np.inf if role in held else GAP_FACTOR * step_s,
            before_s=slack_s,
            after_s=np.inf if role in held else slack_s,
        )
    if not mask.any():
        raise LogError(source, "the time ranges of the channels do not overlap")
    common_time_s = target[mask]
    sampled = {
        role: _resample(
            channel.values, clocks[role], common_time_s, is_held=role in held or role in HOLD_ROLES
        )
        if role in other_roles
        else channel.values[mask]
        for role, channel in channels.items()
    }
    steps_text = ", ".join(f"{names[role]} {steps[role]:.4g} s" for role in channels)
    is_selection = len(set(steps.values())) == 1 and all(
        np.all(np.isin(common_time_s, clocks[role])) for role in other_roles
    )
    notices = [] if is_selection else [f"resampled to the clock of {names[reference]}: {steps_text}"]
    notices += [
        f"{names[role]} is sampled every {steps[role]:.3g} s, {names[reference]} every "
        f"{steps[reference]:.3g} s: dead times are known no better than that"
        for role in HOLD_ROLES
        if role in other_roles - held and steps[role] > SLOWEST_COMMAND * steps[reference]
    ]
    return common_time_s, sampled, notices


def _is_logged_on_change(role: str, values: np.ndarray, clock: np.ndarray, measured_step_s: float) -> bool:
    """Return whether a channel was written when it changed, so that each sample holds until the next.

    Its samples are rarer than the displacement's, and irregular; a command's may also never repeat, but in
    the sample that closes the log.
    """
    intervals = np.diff(clock)
    step_s = float(np.median(intervals))
    shorter, longer = np.quantile(intervals, [1 - ON_CHANGE_QUANTILE, ON_CHANGE_QUANTILE])
    is_irregular = bool(longer > GAP_FACTOR * step_s or step_s > GAP_FACTOR * shorter)
    is_rare = step_s > ON_CHANGE_STEPS * measured_step_s
    return is_rare and (is_irregular or (role in HOLD_ROLES and bool(np.all(np.diff(values[:-1])))))


def _check_agrees(source: Path | str, time_s: np.ndarray, channel: LogChannel, name: str) -> None:
    """Refuse a time that lasts longer or shorter than the channel's own clock."""
    clock = channel.clock_s
    if clock is None or clock.size < 2:
        return
    clock_duration_s, time_duration_s = float(clock[-1] - clock[0]), float(time_s[-1] - time_s[0])
    if not abs(clock_duration_s - time_duration_s) <= abs(time_duration_s) / (clock.size - 1):
        problem = f"lasts {clock_duration_s:g} s on its own clock, {time_duration_s:g} s on the time channel"
        raise LogError(
            source, f"{problem}; name the time channel of its own group in campaign.toml", column=name
        )


def _with_increasing_clock(source: Path | str, role: str, channel: LogChannel, name: str) -> LogChannel:
    """Return a channel whose clock increases from sample to sample."""
    clock = channel.clock_s
    if clock is None:
        problem = 'has no clock in the file; name the time channel in campaign.toml: time = "…"'
        raise LogError(source, problem, column=name)
    if clock.size < 2:
        raise LogError(source, f"has {clock.size} samples, expected at least 2", column=name)
    rows = unique_stamp_rows(clock, source, column=name, line_of=lambda _: None)
    if rows.size == clock.size:
        return channel
    values = one_sample_a_stamp(channel.values, clock, rows, is_held=role in HOLD_ROLES)
    return channel._replace(values=values, clock_s=clock[rows])


def _resample(
    samples: np.ndarray, source_time_s: np.ndarray, target_time_s: np.ndarray, *, is_held: bool
) -> np.ndarray:
    role = COMMAND[LIFTING] if is_held else DISPLACEMENT
    return resampled({role: samples}, source_time_s, target_time_s)[role]


def _is_covered(
    target: np.ndarray, clock: np.ndarray, *, longest_s: float, before_s: float, after_s: float
) -> np.ndarray:
    """Return where a channel is known, shape [N].

    Args:
        target: instants, s, shape [N].
        clock: of the channel, s.
        longest_s: interval between two of its samples, above which what is between is not known.
        before_s, after_s: how far beyond its first and last sample it is known.
    """
    after = np.clip(np.searchsorted(clock, target), 1, clock.size - 1)
    nearest_s = np.minimum(np.abs(target - clock[after]), np.abs(target - clock[after - 1]))
    without_gap = (clock[after] - clock[after - 1] <= longest_s) | (nearest_s <= CLOCK_TOLERANCE_S)
    return without_gap & (target >= clock[0] - before_s) & (target <= clock[-1] + after_s)
