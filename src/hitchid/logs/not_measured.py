"""Samples that no sensor measured: missing values, error codes of loggers, stale starts of logs."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hitchid._support.records import Notice, Severity
from hitchid.errors import LogError
from hitchid.logs.content import LogChannel
from hitchid.logs.record import DISPLACEMENT, HOLD_ROLES
from hitchid.logs.resampling import SHORT_GAP_S, SHORT_GAP_STEPS, LineOf

NOT_MEASURED = "not-measured"  # code of the notices
FEWEST_SAMPLES = 20  # samples left beside an error code, from which motion and noise are known (chosen)
NEIGHBOURS = 5  # steps compared before and after (chosen)
ISOLATION = 5.0  # times the neighbouring steps; a piston accelerates over several samples
NOISE_SIGMAS, FASTER_THAN_MOTION = 8.0, 3.0  # σ of one sample; times the 99th percentile of steps (chosen)
SHORT_SAMPLES = 3  # samples; after a longer interruption the piston may be elsewhere (chosen)
COMMAND_RATIO = 20.0  # times the largest other command; no valve is driven so far for a moment (chosen)
STALE_SAMPLES = 10  # samples; longest stale start (chosen)
REST_SAMPLES = 200  # samples at rest behind the start, which show its noise (chosen)
REST_ISOLATION = 3.0  # times the largest step at rest (chosen)
MIN_STALE_FRACTION = 0.002  # of the range; a smaller error at the start does not matter (chosen)
FILLED_SHARE = 0.1  # of a channel; with more missing, the channel has a clock of its own (chosen)
NORMAL_MEDIAN, SECOND_DIFFERENCE = 0.6745, 6.0**0.5  # of |d²y| of white normal noise of unit variance


def without_unmeasured(
    source: Path | str,
    time: LogChannel | None,
    channels: Mapping[str, LogChannel],
    names: Mapping[str, str],
    line_of: LineOf,
) -> tuple[LogChannel | None, dict[str, LogChannel], list[Notice]]:
    """Return time and channels without samples that no sensor measured, and a notice for each channel.

    Gaps up to 0.2 s or three samples are closed: commands hold their value, other signals are interpolated.
    What is missing longer, at an end, or in more than a tenth of a channel is left out of it, and every
    channel then has a clock of its own. The time, s, is None if every channel has a clock.

    Raises:
        LogError: a channel holds no number.
    """
    cleaned, missing_rows, notices = dict(channels), {}, []
    commands = [channels[role].values for role in HOLD_ROLES if role in channels]
    for role, channel in channels.items():
        values, clock = channel.values, channel.clock_s if time is None else time.values
        if clock is None or clock.size != values.size or values.size < 2:
            continue  # the clocks refuse it
        # Infinite numbers, too: no sensor reads them.
        missing = ~np.isfinite(values)
        if missing.all():
            problem = f"expected finite numbers, got {values[0]} in all {values.size} samples"
            raise LogError(source, problem, line=line_of(0), column=names[role])
        kinds = ["hold no number"] if missing.any() else []
        # Before the stale start, which is judged by jumps: an error code is no jump of the piston.
        for code, rows in _error_codes(values, missing, is_command=role in HOLD_ROLES):
            kinds.append(f"read {_reading(code, channel)}, as a logger writes for an error")
            missing[rows] = True
        if role == DISPLACEMENT and (stale := _stale_start(values, missing, commands)):
            rows = np.flatnonzero(~missing)[: stale + 1]
            first, follows = (_reading(float(values[row]), channel) for row in rows[[0, -1]])
            kinds.append(f"are stale at the start of the log: {first}, and {follows} without motion between")
            missing[rows[:-1]] = True
        if not missing.any():
            continue
        filled, missing_rows[role] = _filled(values, missing, clock, is_held=role in HOLD_ROLES)
        cleaned[role] = channel._replace(values=filled)
        sentence = (
            f"{np.count_nonzero(missing)} of {values.size} samples are left out, the first in "
            f"{sample_or_line(int(np.argmax(missing)), line_of)}: they {', or '.join(kinds)}"
        )
        notices.append(Notice(NOT_MEASURED, sentence, role, Severity.WARNING))
    # All gaps were closed: the log keeps its one clock, and its lines.
    if not any(rows.any() for rows in missing_rows.values()):
        return time, cleaned, notices
    for role, channel in cleaned.items():
        clock = channel.clock_s if time is None else time.values
        rows = ~missing_rows.get(role, np.zeros(channel.values.size, dtype=bool))
        if clock is not None and clock.size == rows.size:
            cleaned[role] = channel._replace(values=channel.values[rows], clock_s=clock[rows])
    return None, cleaned, notices


def sample_or_line(sample: int, line_of: LineOf) -> str:
    """Return where a sample stands: its line in the file, its number for a format without lines."""
    line = line_of(sample)
    return f"sample {sample}" if line is None else f"line {line}"


def _reading(value: float, channel: LogChannel) -> str:
    return f"{value:.6g} {channel.unit or ''}".rstrip()


def _filled(
    values: np.ndarray, missing: np.ndarray, clock: np.ndarray, *, is_held: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples with short gaps closed, and which samples stay missing, both of shape [N]."""
    # So much is missing in a channel that was logged more rarely than the others.
    if np.count_nonzero(missing) > FILLED_SHARE * values.size:
        return values, missing
    rows = np.flatnonzero(~missing)
    step_s = float(np.median(np.diff(clock)))
    # The last number up to each sample, and the next after it.
    samples = np.arange(values.size)
    next_row = np.searchsorted(rows, samples, side="right")
    before, after = (rows[np.clip(k, 0, rows.size - 1)] for k in (next_row - 1, next_row))
    is_inside = (before < samples) & (after > samples)
    is_short = clock[after] - clock[before] <= max(SHORT_GAP_S, (SHORT_GAP_STEPS + 0.5) * step_s)
    closed = missing & is_inside & is_short
    filled = values.copy()
    filled[closed] = (
        values[before[closed]] if is_held else np.interp(clock[closed], clock[rows], values[rows])
    )
    return filled, missing & ~closed


def _error_codes(
    values: np.ndarray, missing: np.ndarray, *, is_command: bool
) -> Iterator[tuple[float, np.ndarray]]:
    """Yield each error code of a channel and the samples that read it.

    Candidates are the lowest and the highest reading and zero. Of a measured signal a code interrupts the
    motion: readings before and after are much nearer to each other, and to their neighbours, than to it. It
    is exactly zero, occurs at two times, or lies farther outside the range of the others than that is wide.
    Of a command, which may jump, a code lasts at most three samples and is more than 20 times the largest
    other command.
    """
    rows = np.flatnonzero(~missing)
    while True:
        readings = values[rows]
        if readings.size <= FEWEST_SAMPLES:
            return
        middle = float(np.median(readings))
        candidates = {float(readings.min()), float(readings.max()), 0.0}
        # The farthest first: while it is among the readings, their noise and range hide a nearer one.
        for code in sorted(candidates, key=lambda code: -abs(code - middle)):
            is_code = readings == code
            if not 0 < np.count_nonzero(is_code) <= readings.size - FEWEST_SAMPLES:
                continue
            if is_command:
                starts, stops = true_intervals(is_code)
                largest = float(np.max(np.abs(readings[~is_code])))
                is_far = abs(code) > COMMAND_RATIO * largest > 0
                errors = is_code & (is_far and bool(np.all(stops - starts <= SHORT_SAMPLES)))
            else:
                errors = _interruptions(readings, is_code)
            if errors.any():
                yield code, rows[errors]
                rows = rows[~errors]
                break
        else:
            return


def _interruptions(readings: np.ndarray, is_code: np.ndarray) -> np.ndarray:
    """Return where a measured signal reads an error code, shape [N]."""
    code, others = float(readings[is_code][0]), readings[~is_code]
    starts, stops = true_intervals(is_code)
    # Positions among the others: the last before an interruption and the first after it.
    before = starts - np.concatenate([[0], np.cumsum(stops - starts)[:-1]]) - 1
    after = before + 1
    steps = np.abs(np.diff(others))
    offsets = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    near = before[:, None] + offsets
    counts = (near >= 0) & (near < steps.size)
    # Over a longer interruption the piston moves on: the step across it shows nothing.
    counts &= (offsets != 0) | (stops - starts <= SHORT_SAMPLES)[:, None]
    # What the piston does around the interruption is the measure: near a spike it may move fast.
    motion = np.max(np.where(counts, steps[np.clip(near, 0, steps.size - 1)], 0.0), axis=1)
    left = np.where(before >= 0, np.abs(others[np.maximum(before, 0)] - code), np.inf)
    right = np.where(after < others.size, np.abs(others[np.minimum(after, others.size - 1)] - code), np.inf)
    height = np.minimum(left, right)
    # What is short and at the start is stale, whatever it reads.
    is_start = (starts == 0) & (stops <= STALE_SAMPLES)
    interrupts = (height > ISOLATION * motion) & ~is_start
    if not interrupts.any():
        return np.zeros(is_code.size, dtype=bool)
    # Neighbours at rest move by nothing at all: then noise and the fastest motion are the measure.
    interrupts &= height > max(_noise_limit(others), FASTER_THAN_MOTION * _fast_step(steps))
    low, high = np.percentile(others, [1, 99])
    is_far = max(low - code, code - high) > high - low
    # Any other single reading inside the range may be a real one.
    if not (code == 0.0 or is_far or np.count_nonzero(interrupts) >= 2):
        return np.zeros(is_code.size, dtype=bool)
    # Interruptions are stretches of samples: counted up at their starts, down at their ends.
    marks = np.zeros(is_code.size + 1, dtype=np.int64)
    np.add.at(marks, starts[interrupts], 1)
    np.add.at(marks, stops[interrupts], -1)
    return np.cumsum(marks[:-1]) > 0


def _stale_start(values: np.ndarray, missing: np.ndarray, commands: Sequence[np.ndarray]) -> int:
    """Return the number of stale samples at the start of a displacement.

    The piston jumps once within the first ten samples, by more than it moves in any sample that follows at
    rest, or in the next five if it is not at rest: no piston starts and stops within one sample.
    """
    readings = values[~missing]
    if readings.size <= FEWEST_SAMPLES + STALE_SAMPLES:
        return 0
    steps = np.abs(np.diff(readings))
    # Samples before a command first changes; none if it has another clock.
    rest = 0 if any(command.size != values.size for command in commands) or not commands else values.size
    for command in commands if rest else ():
        changed = np.abs(command - command[0]) > MIN_STALE_FRACTION * np.ptp(command)
        rest = min(rest, int(np.argmax(changed)) if np.any(changed) else rest)
    fast = FASTER_THAN_MOTION * _fast_step(steps[STALE_SAMPLES:])
    least = max(_noise_limit(readings[STALE_SAMPLES:]), MIN_STALE_FRACTION * np.ptp(readings[STALE_SAMPLES:]))
    # From the longest on: within a stale start nothing moves, so a shorter one would leave a part of it.
    for stale in range(STALE_SAMPLES, 0, -1):
        following = steps[stale : max(stale + NEIGHBOURS, min(rest, REST_SAMPLES))]
        at_rest = np.count_nonzero(following) > NEIGHBOURS and np.ptp(readings[:stale]) == 0
        limit = REST_ISOLATION * following.max() if at_rest else max(ISOLATION * following.max(), fast)
        if steps[stale - 1] > max(limit, least):
            return stale
    return 0


def _fast_step(steps: np.ndarray) -> float:
    """Return the 99th percentile of the steps that are none of zero."""
    moving = steps[steps > 0]
    return float(np.percentile(moving, 99)) if moving.size else 0.0


def _noise_limit(readings: np.ndarray) -> float:
    """Return what noise and rounding change at most from one sample to the next."""
    # Second differences: they vanish for motion at constant speed, which noise does not.
    differences = np.diff(readings)
    changes = np.abs(differences[differences != 0])
    noise = float(np.median(np.abs(np.diff(differences)))) / NORMAL_MEDIAN / SECOND_DIFFERENCE
    return NOISE_SIGMAS * 2**0.5 * noise + 2 * float(np.min(changes, initial=np.inf) if changes.size else 0.0)


def true_intervals(condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return first samples and one past the last of every interval where a condition is true."""
    edges = np.flatnonzero(np.diff(condition.astype(np.int8), prepend=0, append=0))
    return edges[::2], edges[1::2]
