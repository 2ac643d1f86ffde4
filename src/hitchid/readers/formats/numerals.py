"""Numbers as text: decimal sign, thousands, missing values, words for on and off."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid.readers.formats.stamps import is_stamp

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
        if text.isascii() and "_" not in text and (sign == "." or "." not in text):
            try:
                plain = cells if sign == "." else [cell.replace(",", ".") for cell in cells]
                return np.fromiter(map(float, plain), float, len(cells)), np.zeros(len(cells), dtype=bool)
            except ValueError:
                pass
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
