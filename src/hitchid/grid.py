"""From the time stamps of a logger to a uniform grid: kept, resampled, or split at gaps."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hitchid.errors import LogError

LineOf = Callable[[int], int | None]
KEPT_DEVIATION = 0.02
LARGEST_JITTER = 0.20
GAP = 1.5
SHORTEST_STEP_S = 1e-9


@dataclass(frozen=True)
class Section:
    """Rows `start:stop` of a log that lie on one clock.

    Attributes:
        start, stop: row range.
        step_s: sampling time of the uniform grid, s.
        resampled: whether the rows must be interpolated onto the grid.
        notice: what was found and done, empty where the clock was regular.
    """

    start: int
    stop: int
    step_s: float
    resampled: bool
    notice: str


def sections(time_s: np.ndarray, source: object, *, column: str, line_of: LineOf) -> list[Section]:
    """Cut a time column into stretches with a uniform clock.

    An interval beyond 1.5 times the median is a gap and splits the log; a stretch whose stamps stay within
    2 % of a sampling time of the uniform grid is kept as it is; one whose intervals jitter by less than
    20 % is to be resampled.

    Args:
        time_s: time stamps, s, shape [N].
        source: the log's name, for messages.
        column: the time column's name, for messages.
        line_of: from a row to its line in the file, None where the format has no lines.

    Raises:
        LogError: time does not increase, jitters by 20 % of the sampling time or more, or has steps that no
            logger has.
    """

    intervals = np.diff(time_s)
    if intervals.size == 0:
        return []
    backward = np.flatnonzero(intervals <= 0)
    if backward.size:
        row = int(backward[0]) + 1
        raise LogError(
            source,
            f"time must increase from sample to sample; {time_s[row]:g} s came after {time_s[row - 1]:g} s",
            line=line_of(row),
            column=column,
        )
    median = float(np.median(intervals))
    if not SHORTEST_STEP_S <= median <= np.max(intervals) < np.inf:
        raise LogError(
            source,
            f"the sampling time is {median:g} s, the longest interval {np.max(intervals):g} s; "
            f"required {SHORTEST_STEP_S:g} s or more, and no interval without end",
            column=column,
        )
    cuts = np.flatnonzero(intervals > GAP * median) + 1
    edges = [0, *(int(cut) for cut in cuts), time_s.size]
    found = []
    for start, stop in pairwise(edges):
        if stop - start < 2:
            continue
        notice = ""
        if start > 0:
            gap = time_s[start] - time_s[start - 1]
            notice = f"split at {time_s[start]:g} s: a gap of {gap:.3g} s, {gap / median:.1f} sampling times"
        found.append(_section(time_s, start, stop, notice, source, column, line_of(start)))
    return found


def _section(
    time_s: np.ndarray, start: int, stop: int, notice: str, source: object, column: str, line: int | None
) -> Section:
    stamps = time_s[start:stop]
    step = _nominal_step(stamps)
    deviation = np.max(np.abs(stamps - stamps[0] - step * np.arange(stamps.size))) / step
    if deviation <= KEPT_DEVIATION:
        return Section(start, stop, step, resampled=False, notice=notice)
    jitter = float(np.max(np.abs(np.diff(stamps) - step))) / step
    if jitter >= LARGEST_JITTER:
        raise LogError(
            source,
            f"the clock jitters by {jitter:.0%} of its sampling time of {step:.4g} s; required below 20 %",
            line=line,
            column=column,
        )
    said = f"resampled: the clock jitters by {jitter:.1%} of {step:.4g} s"
    return Section(start, stop, step, resampled=True, notice="; ".join(filter(None, [notice, said])))


def _nominal_step(stamps: np.ndarray) -> float:
    """Return the mean interval, rounded to four digits where the stamps cannot tell the difference."""
    step = float(stamps[-1] - stamps[0]) / (stamps.size - 1)
    rounded = float(f"{step:.4g}")
    drift = abs(rounded - step) * (stamps.size - 1)
    return rounded if drift <= KEPT_DEVIATION * step else step
