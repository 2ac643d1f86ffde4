"""Time stamps in text: dates, times of day and durations, to seconds since the first."""

import re
from collections.abc import Iterable, Sequence
from datetime import date

import numpy as np

# Two numbers around a colon, or a date; what stands behind a zone's sign is its offset from UTC.
STAMP = re.compile(
    r"""
    (?: (?P<first>\d{1,4}) (?P<mark>[-./]) (?P<second>\d{1,2}|[^\W\d]{3,9}) \.? (?P=mark) (?P<third>\d{1,4})
      | (?P<compact>\d{8}) (?=[T_\ -]\d{6})
      | (?P<days>\d{1,6}) (?: \s*days? | [.:](?=\d{1,2}:\d\d:\d\d[.,]\d) ) )?
    (?(first) (?:\s*[T,_-]\s*|\s+) | (?(compact) [T_\ -] | ,?\s*))
    (?: (?P<hour>\d{1,3}) : (?P<minute>\d\d) (?: : (?P<second_of_minute>\d\d) )?
      | (?P<compact_time>\d{6}) )
    (?: [.,:] (?P<fraction>\d{1,9}) \d* )?
    (?: \s*(?P<half>[AaPp])\.?[Mm]\.? )?
    \s* (?: (?P<sign>[+-]) (?P<zone_hour>\d\d) :? (?P<zone_minute>\d\d)? | Z | [A-Z]{3,4} )?
    """,
    re.VERBOSE,
)
MONTHS = {
    name: month
    for month, names in enumerate(
        (
            "jan",
            "feb",
            "mar mär mrz",
            "apr",
            "may mai",
            "jun",
            "jul",
            "aug",
            "sep",
            "oct okt",
            "nov",
            "dec dez",
        ),
        start=1,
    )
    for name in names.split()
}
NS = 10**9  # in a second; stamps are counted in whole ns until the first is subtracted
DAY_S, HOUR_S = 86_400, 3_600
MISSING = np.iinfo(np.int64).min
Date = tuple[str, str, str]  # its three parts, in the order of the text


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a date with a time, a time of day or a duration such as `00:01.250`."""
    return (":" in cell and STAMP.fullmatch(cell) is not None) or _is_compact(cell)


def _is_compact(cell: str) -> bool:
    return len(cell) > 14 and cell[:8].isdigit() and STAMP.fullmatch(cell) is not None


class Stamps:
    """Parser of the stamps of one column, block by block.

    The order of day and month follows from all dates: the valid order in which the log is shortest.
    """

    def __init__(self) -> None:
        """Begin without a stamp."""
        self._dates: dict[Date | None, int] = {}
        self._wraps_hourly = False

    def parse(self, cells: Sequence[str]) -> np.ndarray:
        """Return the stamps of a block for `seconds`, shape [2, N]; MISSING where there is none."""
        stamps = np.full((2, len(cells)), MISSING)
        for row, cell in enumerate(cells):
            match = STAMP.fullmatch(cell.strip())
            if match is not None:
                day, stamps[0, row] = self._parse(match)
                stamps[1, row] = self._dates.setdefault(day, len(self._dates))
        return stamps

    def _parse(self, match: re.Match[str]) -> tuple[Date | None, int]:
        """Return the date and the ns since its midnight in UTC."""
        parts = match.groupdict()
        if parts["compact_time"]:
            hour, minute, second = (int(parts["compact_time"][k : k + 2]) for k in (0, 2, 4))
        else:
            hour, minute, second = int(parts["hour"]), int(parts["minute"]), parts["second_of_minute"]
            if second is None and parts["fraction"]:  # as spreadsheets show it: minutes, seconds, tenths
                self._wraps_hourly = True
                hour, minute, second = 0, hour, minute
        if parts["half"]:
            hour = hour % 12 + 12 * (parts["half"] in "pP")
        seconds = HOUR_S * hour + 60 * minute + int(second or 0) + DAY_S * int(parts["days"] or 0)
        if parts["sign"]:
            offset_s = HOUR_S * int(parts["zone_hour"]) + 60 * int(parts["zone_minute"] or 0)
            seconds -= offset_s if parts["sign"] == "+" else -offset_s
        ticks = NS * seconds + int((parts["fraction"] or "0").ljust(9, "0"))
        if parts["compact"]:
            text = parts["compact"]
            return (text[:4], text[4:6], text[6:]), ticks
        return (parts["first"], parts["second"], parts["third"]) if parts["first"] else None, ticks

    def seconds(self, stamps: np.ndarray) -> np.ndarray:
        """Return the seconds since the first stamp, shape [N]; NaN for a cell that is none.

        A time without a date that falls by more than half a day continues on the next day; minutes and
        seconds alone by more than half an hour, in the next hour.

        Args:
            stamps: all blocks of `parse`, shape [2, N].

        Raises:
            ValueError: the dates are not those of a calendar.
        """
        ticks, dates = stamps
        valid = np.flatnonzero(ticks != MISSING)
        times = ticks[valid]
        if None in self._dates:
            period = NS * (HOUR_S if self._wraps_hourly else DAY_S)
            wraps = np.diff(times, prepend=times[:1]) < -period // 2
            times = times + period * np.cumsum(wraps)
        else:
            times = times + NS * DAY_S * self._days()[dates[valid]]
        seconds = np.full(ticks.size, np.nan)
        seconds[valid] = (times - times[0]) / NS
        return seconds

    def _days(self) -> np.ndarray:
        """Return the day of each date, counted from any origin, in the order in which they came."""
        orders = [
            days for order in ("ymd", "dmy", "mdy") if (days := _ordinals(self._dates, order)) is not None
        ]
        if not orders:
            shown = "-".join(next(iter(self._dates)) or ())
            raise ValueError(f"the dates are not those of a calendar, such as '{shown}'")
        # Falling dates are the wrong order of day and month, or a log that no order makes usable.
        return min(orders, key=lambda days: (bool(np.any(np.diff(days) < 0)), np.ptp(days)))


def _ordinals(dates: Iterable[Date | None], order: str) -> np.ndarray | None:
    """Return the ordinal of each date read in an order, None if one is no date."""
    days = []
    for parts in dates:
        fields = dict(zip(order, parts or (), strict=True))
        month = MONTHS.get(fields["m"][:3].lower()) or (int(fields["m"]) if fields["m"].isdigit() else 0)
        if not fields["y"].isdigit() or not fields["d"].isdigit() or len(fields["y"]) not in (2, 4):
            return None
        year = int(fields["y"]) + (2000 if len(fields["y"]) == 2 else 0)
        try:
            days.append(date(year, month, int(fields["d"])).toordinal())
        except ValueError:
            return None
    return np.array(days, dtype=np.int64)
