"""Numbers as text: decimal sign, thousands, missing values, words for on and off."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from typing import NamedTuple

import numpy as np

# Time stamps in text: dates, times of day and durations, to seconds since the first.

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
MONTHS = {  # English and German
    name: month
    for month, names in enumerate(
        [
            "jan",
            "feb",
            "mar/mär/mrz",
            "apr",
            "may/mai",
            "jun",
            "jul",
            "aug",
            "sep",
            "oct/okt",
            "nov",
            "dec/dez",
        ],
        start=1,
    )
    for name in names.split("/")
}
NS = 10**9  # in a second; stamps are counted in whole ns until the first is subtracted
DAY_S, HOUR_S = 86_400, 3_600
MISSING = np.iinfo(np.int64).min
Date = tuple[str, str, str]  # its three parts, in the order of the text


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a date with a time, a time of day or a duration such as `00:01.250`."""
    may_be_compact = len(cell) > 14 and cell[:8].isdigit()
    return (":" in cell or may_be_compact) and STAMP.fullmatch(cell) is not None


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
        # Two digits: no log is older than the millennium.
        year = int(fields["y"]) + (2000 if len(fields["y"]) == 2 else 0)
        try:
            days.append(date(year, month, int(fields["d"])).toordinal())
        except ValueError:
            return None
    return np.array(days, dtype=np.int64)


NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
WORDS = {
    word: value
    for value, words in ((1.0, "on true yes ein an wahr ja"), (0.0, "off false no aus falsch nein"))
    for word in words.split()
}
DIGIT_GROUPS = re.compile(r"(?<=\d)[\u00a0\u202f' ](?=\d{3}(?!\d))")  # thousands that only look one way
LONGEST_SHOWN = 40  # characters of a cell in a message


class _Sign(NamedTuple):
    """Patterns of the cells of a column, one a line, for one decimal sign.

    Attributes:
        decimal: a cell whose sign can only be decimal: `0,5`, `1,25`, `1234,567`, `1,317e3`.
        grouped: a cell whose sign can only separate thousands: `1,234,567`, `1,234.5`.
        either: a cell that may be either: `1,317`.
    """

    decimal: re.Pattern[str]
    grouped: re.Pattern[str]
    either: re.Pattern[str]


def _patterns(sign: str, other: str) -> _Sign:
    s, o = re.escape(sign), re.escape(other)
    return _Sign(
        re.compile(
            rf"^ *[+-]?(?:0*{s}\d+|0+{s}\d*|\d+{s}(?:\d{{1,2}}|\d{{4,}})?|\d{{4,}}{s}\d*|\d+{s}\d+(?=[eE]))"
            rf"(?:[eE][+-]?\d+)? *$",
            re.MULTILINE,
        ),
        re.compile(
            rf"^ *[+-]?[1-9]\d{{0,2}}(?:{s}\d{{3}})+(?:(?<={s}\d\d\d{s}\d\d\d)|{o}\d*) *$", re.MULTILINE
        ),
        re.compile(rf"^ *([+-]?[1-9]\d{{0,2}}{s}\d{{3}}) *$", re.MULTILINE),
    )


SIGNS = {",": _patterns(",", "."), ".": _patterns(".", ",")}
SHORT_INTEGER = re.compile(r"^ *[+-]?\d{1,3} *$", re.MULTILINE)


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with either decimal sign, or a time stamp."""
    return NUMBER.fullmatch(cell) is not None or is_stamp(cell)


class CellError(Exception):
    """A cell that is no number: its row in the block, its column and the problem."""

    def __init__(self, row: int, name: str, problem: str) -> None:
        """Keep row, column and problem."""
        self.row, self.name, self.problem = row, name, problem
        super().__init__(problem)


class Numerals:
    """Decimal sign of a text log, found from all of its numbers.

    A cell whose sign can only be decimal decides for the whole log. As long as there is none, `1,317` is read
    as a decimal number, and refused at the end if its column has whole numbers below 1000 as well: these
    are what a log with thousands separators has between its thousands.

    Attributes:
        sign: the decimal sign; None as long as no number shows it.
    """

    def __init__(self, sign: str | None = None) -> None:
        """Begin with a known decimal sign or without one."""
        self.sign = sign
        self._assumed: str | None = None
        self._either: dict[str, str] = {}
        self._with_integers: set[str] = set()

    def examine(self, columns: Mapping[str, str]) -> None:
        """Look for the decimal sign in a block: name to the cells of a column, one a line.

        Raises:
            CellError: the block proves that a number in a block before was misread.
        """
        if self.sign is not None:
            return
        columns = {name: DIGIT_GROUPS.sub("", text) for name, text in columns.items()}
        for sign, patterns in SIGNS.items():
            for text in columns.values():
                if sign in text and patterns.decimal.search(text):
                    self.sign = sign
                elif sign in text and patterns.grouped.search(text):
                    self.sign = "." if sign == "," else ","
                if self.sign is not None and self._assumed not in (None, self.sign):
                    raise CellError(
                        0, next(iter(self._either)), _ambiguity(next(iter(self._either.values())))
                    )
                if self.sign is not None:
                    return
        for name, text in columns.items():
            for sign, patterns in SIGNS.items():
                if sign in text and (match := patterns.either.search(text)):
                    self._assumed = self._assumed or sign
                    self._either.setdefault(name, match.group(1))
            if SHORT_INTEGER.search(text):
                self._with_integers.add(name)

    def conclude(self) -> tuple[str, ...]:
        """Return the notices on numbers that were assumed to be decimal, once all blocks were examined.

        Raises:
            CellError: thousands and decimal numbers cannot be told apart.
        """
        if self.sign is not None:
            return ()
        for name, cell in self._either.items():
            if name in self._with_integers:
                raise CellError(0, name, _ambiguity(cell))
        return tuple(
            f"{name}: '{cell}' is read with a decimal comma; nothing in the log shows whether it is one"
            for name, cell in self._either.items()
            if "," in cell
        )

    def numbers(self, name: str, cells: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers of examined cells, NaN where there is none, and which are no number.

        A cell without a digit, such as an empty one, `---` or `#N/A`, is a missing value, but words for on
        and off are 1 and 0. All other text is no number.

        Raises:
            CellError: a cell has the other decimal sign.
        """
        text = "\n".join(cells)
        sign = self.sign or self._assumed or "."
        # Python reads 1_000 and digits of other scripts as numbers, which no logger means.
        if text.isascii() and "_" not in text and (sign == "." or "." not in text):
            try:
                plain = cells if sign == "." else [cell.replace(",", ".") for cell in cells]
                return np.fromiter(map(float, plain), float, len(cells)), np.zeros(len(cells), dtype=bool)
            except ValueError:
                pass
        # The slow way is taken only where a cell is more than a plain number.
        has_thousands = SHORT_INTEGER.search(text) is not None
        values, bad = np.full(len(cells), np.nan), np.zeros(len(cells), dtype=bool)
        for row, cell in enumerate(map(str.strip, cells)):
            value = _number(cell, sign, has_thousands=has_thousands)
            if value is not None:
                values[row] = value
            elif NUMBER.fullmatch(cell):
                raise CellError(row, name, expected(cell, sign))
            else:
                bad[row] = True
        return values, bad


def _number(cell: str, sign: str, *, has_thousands: bool) -> float | None:
    """Return the number of a cell, NaN for a missing value, None for other text."""
    # The words for a missing value have no digit, or the # of a spreadsheet's or a C library's error.
    if not any(map(str.isdigit, cell)) or "#" in cell:
        return WORDS.get(cell.lower(), float(cell) if NUMBER.fullmatch(cell) else np.nan)
    other = "," if sign == "." else "."
    plain = DIGIT_GROUPS.sub("", cell)
    if other in plain and (
        SIGNS[other].grouped.fullmatch(plain) or (has_thousands and SIGNS[other].either.fullmatch(plain))
    ):
        plain = plain.replace(other, "")
    if not plain.isascii() or "_" in plain or other in plain:
        return None
    try:
        return float(plain.replace(sign, "."))
    except ValueError:
        return None


def expected(cell: str, sign: str | None) -> str:
    """Return the message on a cell that is no number."""
    number = "a number with a decimal comma, as in other cells" if sign == "," else "a number"
    shown = repr(cell if len(cell) <= LONGEST_SHOWN else f"{cell[:LONGEST_SHOWN]}…")
    return f"expected {number}, got {shown if cell else 'an empty cell'}"


def _ambiguity(cell: str) -> str:
    sign = "comma" if "," in cell else "point"
    return f"'{cell}' is ambiguous: a decimal {sign} or a thousands separator; use no thousands separator"
