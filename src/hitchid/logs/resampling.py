"""Uniform time grid from the time stamps of a log: adopted, resampled, or split at gaps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hitchid._support.records import Notice
from hitchid.errors import LogError

LineOf = Callable[[int], int | None]
GRID_TOLERANCE = 0.02  # of the sampling time; largest distance of a stamp on the grid (chosen)
AFTER_GAP = "gap-split"  # code of the notice of a section that begins after a gap
GAP_FACTOR = 1.5  # of the sampling time; a longer interval is a gap (chosen)
SHORTEST_STEP_S = 1e-9  # s; the resolution of time stamps in ns
# s and sampling times, the larger counts: a hydraulic axis changes its speed in 0.2 s; two lost samples.
SHORT_GAP_S, SHORT_GAP_STEPS = 0.2, 3
# s and sampling times, the larger counts: longest interpolation at constant command and speed (chosen).
LONGEST_BRIDGE_S, LONGEST_BRIDGE_STEPS = 1.0, 10
# Fraction of a command's range, fraction of the displacement's range, rows per speed estimate (chosen).
COMMAND_TOLERANCE, MOTION_TOLERANCE, SPEED_ROWS = 0.1, 0.05, 5
# Fewest rows a stamp of a coarse clock; share of rows within stamps whose displacement is new (chosen).
MIN_ROWS_A_STAMP, CHANGED_SHARE = 1.25, 0.1


@dataclass(frozen=True)
class ClockQuality:
    """Regularity of a log's clock; all zero for time stamps on a uniform grid.

    Attributes:
        jitter: largest deviation of an interval without lost samples, as a fraction of the sampling time.
        longest_gap_s: longest interpolated gap, s; 0 without lost samples.
        interpolated_share: share of samples more than 2 % of the sampling time from any time stamp.
        logged_step_s: sampling time of the log, s; None if the campaign has the same.
    """

    jitter: float = 0.0
    longest_gap_s: float = 0.0
    interpolated_share: float = 0.0
    logged_step_s: float | None = None


REGULAR_CLOCK = ClockQuality()


@dataclass(frozen=True)
class LogSection:
    """Rows `start:stop` of a log that form one record.

    Attributes:
        start, stop: row range.
        step_s: sampling time of the uniform grid, s.
        resampled: whether the rows must be interpolated onto the grid.
        notices: the gap before the section, and its resampling.
        clock: regularity of the time stamps.
    """

    start: int
    stop: int
    step_s: float
    resampled: bool
    notices: tuple[Notice, ...] = ()
    clock: ClockQuality = REGULAR_CLOCK


def unique_stamp_rows(time_s: np.ndarray, source: object, *, column: str, line_of: LineOf) -> np.ndarray:
    """Return the rows whose time, s, differs from that of the row before, indices of shape [M].

    Time that is not finite, decreases, is constant, or has steps below 1 ns or infinite ones, is refused.
    """
    bad = np.flatnonzero(~np.isfinite(time_s))
    if bad.size:
        problem = f"expected finite time stamps, got {time_s[bad[0]]}"
        raise LogError(source, problem, line=line_of(int(bad[0])), column=column)
    intervals = np.diff(time_s)
    backward = np.flatnonzero(intervals < 0)
    if backward.size:
        row = int(backward[0]) + 1
        problem = f"time must not decrease; {time_s[row]:g} s follows {time_s[row - 1]:g} s"
        raise LogError(source, problem, line=line_of(row), column=column)
    if intervals.size and not np.any(intervals):
        problem = f"all {time_s.size} time stamps are {time_s[0]:g} s; expected increasing time stamps"
        raise LogError(source, problem, line=line_of(1), column=column)
    # Of equal stamps the first row stands for all; its sample is chosen later, by kind of signal.
    rows = np.concatenate([[0], np.flatnonzero(intervals) + 1]) if time_s.size else np.arange(0)
    median = float(np.median(intervals[intervals > 0])) if intervals.size else SHORTEST_STEP_S
    longest = float(np.max(intervals, initial=median))
    if not SHORTEST_STEP_S <= median <= longest < np.inf:
        problem = (
            f"the sampling time is {median:g} s, the longest interval {longest:g} s; "
            f"expected {SHORTEST_STEP_S:g} s or more, and finite intervals"
        )
        raise LogError(source, problem, column=column)
    return rows


def spread_stamps(time_s: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, str] | None:
    """Return even time stamps for samples that share theirs, and a notice; None where each has its own.

    A clock that is read in steps longer than the sampling time stamps several samples alike. They were
    sampled evenly where every stamp is within its step of one line over the rows, and anew where the
    displacement differs within stamps.
    """
    intervals = np.diff(time_s)
    rows = np.flatnonzero(intervals) + 1  # first rows of all stamps but the first
    if rows.size < 3 or not np.all(intervals >= 0) or intervals.size < MIN_ROWS_A_STAMP * rows.size:
        return None
    changed = np.diff(position)[intervals == 0] != 0
    # From the first change of the stamp to the last: the log may begin and end within one.
    step_s = float(time_s[rows[-1]] - time_s[rows[0]]) / float(rows[-1] - rows[0])
    even = np.round(time_s[rows[0]] + step_s * (np.arange(time_s.size) - rows[0]), 9)
    resolution_s = float(np.median(intervals[rows - 1]))
    # A logger that repeats rows, or stamps events twice, has one sample a stamp and must not be spread.
    if np.mean(changed) < CHANGED_SHARE or np.max(np.abs(even - time_s)) > resolution_s + step_s:
        return None
    sentence = (
        f"about {resolution_s / step_s:.3g} samples share each time stamp, which are {resolution_s:.4g} s "
        f"apart: they are spread evenly, every {step_s:.4g} s"
    )
    return even, sentence


def one_sample_a_stamp(
    values: np.ndarray, time_s: np.ndarray, rows: np.ndarray, *, is_held: bool
) -> np.ndarray:
    """Return one sample for each time stamp, shape [M]; `rows` are those of `unique_stamp_rows`.

    Loggers that write an event of its own write two rows with one stamp: before and after a command changes.
    A command, which is held, is in force from its last row on; a measured signal takes the row nearest to the
    line through the stamps before and after.
    """
    last_rows = np.append(rows[1:], time_s.size) - 1
    if is_held or rows.size < 2:
        return values[last_rows]
    counts = last_rows - rows + 1
    means, stamps = np.add.reduceat(values, rows) / counts, time_s[rows]
    before, after = np.arange(rows.size) - 1, np.arange(rows.size) + 1
    before[0], after[-1] = after[0], before[-1]  # at the ends the one neighbour there is
    span = stamps[after] - stamps[before]
    share = np.divide(stamps - stamps[before], span, out=np.zeros(rows.size), where=span > 0)
    expected = means[before] + share * (means[after] - means[before])
    error = np.abs(values - np.repeat(expected, counts))
    return values[np.lexsort((error, np.repeat(stamps, counts)))[rows]]


def sections(
    time_s: np.ndarray, commands: Mapping[str, np.ndarray], position: np.ndarray
) -> list[LogSection]:
    """Divide a time column into sections, each one record on a uniform grid.

    The sampling time is the median interval. Time stamps within 2 % of a uniform grid are kept; others are
    resampled. An interval above 1.5 sampling times is a gap. It is interpolated up to 0.2 s or three sampling
    times; and up to 1 s or ten sampling times, if no command changes over it by more than a tenth of its
    range and the travel agrees with the speeds before and after within 5 % of its range. Any other gap
    splits the log.
    """
    intervals = np.diff(time_s)
    if intervals.size == 0:
        return []
    median = float(np.median(intervals))
    short = max(SHORT_GAP_S, (SHORT_GAP_STEPS + GRID_TOLERANCE) * median)
    longest = max(LONGEST_BRIDGE_S, (LONGEST_BRIDGE_STEPS + GRID_TOLERANCE) * median)
    gaps = np.flatnonzero(intervals > max(short, GAP_FACTOR * median))
    # An interpolation must hide no stroke: constant commands, and rest or one speed before and after.
    changed = np.zeros(intervals.size, dtype=bool)
    for command in commands.values():
        changed |= np.abs(np.diff(command)) > COMMAND_TOLERANCE * np.ptp(command)
    tolerance = MOTION_TOLERANCE * float(np.ptp(position))
    cuts = [
        row + 1
        for row in gaps.tolist()
        if intervals[row] > longest or changed[row] or not _is_steady(time_s, position, row, tolerance)
    ]
    # A sample alone between two gaps has no speed, and is left out.
    return [
        _section(time_s, start, stop, median)
        for start, stop in pairwise([0, *cuts, time_s.size])
        if stop - start > 1
    ]


def _is_steady(time_s: np.ndarray, position: np.ndarray, row: int, tolerance: float) -> bool:
    """Return whether the travel over the gap after a row agrees with the speeds before and after."""
    first, last = max(0, row - SPEED_ROWS), min(time_s.size - 1, row + 1 + SPEED_ROWS)
    if first == row or last == row + 1:
        return False  # no speed is known on one side
    travel, gap_s = position[row + 1] - position[row], time_s[row + 1] - time_s[row]
    speeds = [
        float((position[stop] - position[start]) / (time_s[stop] - time_s[start]))
        for start, stop in ((first, row), (row + 1, last))
    ]
    return all(abs(travel - speed * gap_s) <= tolerance for speed in speeds)


def uniform(stamps: np.ndarray, step_s: float) -> np.ndarray:
    """Return the instants of a uniform grid from the first stamp to the last, s, shape [M]."""
    # The last stamp counts where rounding puts it just below a whole number of steps.
    count = int((stamps[-1] - stamps[0]) / step_s * (1 + 1e-12) + 1e-6) + 1
    return stamps[0] + step_s * np.arange(count)


def _section(time_s: np.ndarray, start: int, stop: int, median: float) -> LogSection:
    stamps, notices = time_s[start:stop], ()
    if start > 0:
        gap = time_s[start] - time_s[start - 1]
        sentence = f"split at {time_s[start]:g} s: a gap of {gap:.3g} s, {gap / median:.1f} sampling times"
        notices = (Notice(AFTER_GAP, sentence),)
    intervals = np.diff(stamps)
    # Lost samples count as steps of the grid, so that one gap does not make the step too long.
    grid_indices = np.concatenate([[0], np.cumsum(np.maximum(1, np.rint(intervals / median)))])
    # The mean step, rounded to four digits where the drift stays below the grid tolerance.
    steps = int(grid_indices[-1])
    step = float(stamps[-1] - stamps[0]) / steps
    rounded = float(f"{step:.4g}")
    step = rounded if abs(rounded - step) * steps <= GRID_TOLERANCE * step else step
    deviation = np.max(np.abs(stamps - stamps[0] - step * grid_indices)) / step
    if deviation <= GRID_TOLERANCE and grid_indices[-1] == stamps.size - 1:
        return LogSection(start, stop, step, resampled=False, notices=notices)
    # For irregular stamps a step of two digits is accurate enough, and equal for similar logs.
    step = step if deviation <= GRID_TOLERANCE else float(f"{median:.2g}")
    longest = float(np.max(intervals))
    instants = uniform(stamps, step)
    next_stamp = np.clip(np.searchsorted(stamps, instants), 1, stamps.size - 1)
    distance = np.minimum(np.abs(instants - stamps[next_stamp]), np.abs(instants - stamps[next_stamp - 1]))
    # A lost sample makes a gap, not jitter: it is told apart.
    regular_intervals = intervals[intervals <= GAP_FACTOR * median]
    clock = ClockQuality(
        jitter=float(np.max(np.abs(regular_intervals - step), initial=0.0)) / step,
        longest_gap_s=longest if longest > GAP_FACTOR * median else 0.0,
        interpolated_share=float(np.mean(distance > GRID_TOLERANCE * step)),
    )
    gap_text = f", the longest gap is {clock.longest_gap_s:.3g} s" if clock.longest_gap_s else ""
    sentence = (
        f"resampled: the clock jitters by {clock.jitter:.1%} of {step:.4g} s"
        f"{gap_text}; {clock.interpolated_share:.1%} of the samples are interpolated"
    )
    notices = (*notices, Notice("clock-resampled", sentence))
    return LogSection(start, stop, step, resampled=True, notices=notices, clock=clock)
