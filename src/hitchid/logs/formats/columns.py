"""Columns of a text log, from cells to numbers, block by block."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.numbers import count
from hitchid.errors import LogError
from hitchid.logs.content import Content, LogChannel
from hitchid.logs.formats.numerals import MISSING, CellError, Numerals, Stamps, expected, is_stamp

MAX_BAD_SHARE = 0.01  # of the rows; up to it, cells that are no number count as missing (chosen)


class _Block(NamedTuple):
    """A column of one block: numbers or stamps, and which cells are present, and which are no number."""

    values: np.ndarray
    present: np.ndarray
    bad: np.ndarray


class Columns:
    """Collector of the selected columns.

    A row without a number in any column is no sample: a comment, an event, a repeated header.

    Attributes:
        notices: messages on what is left out.
    """

    def __init__(
        self, path: Path, names: Sequence[str], *, strict: bool, header: int, sign: str | None = None
    ) -> None:
        """Begin without rows.

        Args:
            path: the log, for messages.
            names: of the columns.
            strict: whether a column that holds no numbers is an error; else it is left out.
            header: line of the names, for messages.
            sign: the decimal sign, if the log states it.
        """
        self.notices: list[str] = []
        self._path, self._strict, self._header = path, strict, header
        self._numerals = Numerals(sign)
        self._stamps: dict[str, Stamps] = {}
        self._values: dict[str, list[np.ndarray]] = {name: [] for name in names}
        self._bad: dict[str, tuple[int, LogError]] = {}
        self._lines: list[tuple[int, int | np.ndarray]] = []
        self._without_sample: LogError | None = None
        self._without_count = 0

    def add(self, lines: Sequence[int], columns: Sequence[Sequence[str]]) -> None:
        """Add a block: the lines of its rows, and the cells of each column."""
        cells = dict(zip(self._values, columns, strict=True))
        # By the first block: a column does not turn from stamps into numbers.
        if not self._lines:
            for name, column in cells.items():
                first = next((cell for cell in column if any(map(str.isdigit, cell))), "")
                if is_stamp(first.strip()):
                    self._stamps[name] = Stamps()
        try:
            # Once the sign is known, no block has to be searched for it.
            if self._numerals.sign is None:
                numbers = {name: column for name, column in cells.items() if name not in self._stamps}
                self._numerals.examine({name: "\n".join(column) for name, column in numbers.items()})
            blocks = {name: self._convert(name, column) for name, column in cells.items()}
        except CellError as error:
            raise LogError(self._path, error.problem, line=lines[error.row], column=error.name) from error
        # One number makes a sample: a sensor that failed leaves its cells empty and the others full.
        is_sample = np.any([block.present for block in blocks.values()], axis=0)
        for name, block in blocks.items():
            bad = np.flatnonzero(block.bad & is_sample)
            if bad.size:
                row = int(bad[0])
                bad_count, first = self._bad.get(name, (0, self._error(name, cells[name][row], lines[row])))
                self._bad[name] = bad_count + bad.size, first
            self._values[name].append(block.values[..., is_sample])
        others = np.flatnonzero(~is_sample)
        self._without_count += others.size
        if others.size and self._without_sample is None:
            row = int(others[0])
            name = next((name for name, block in blocks.items() if block.bad[row]), next(iter(cells)))
            self._without_sample = self._error(name, cells[name][row], lines[row])
        kept = np.array(lines)[is_sample]
        # Most blocks: two numbers then stand for the lines of all rows.
        is_contiguous = kept.size and kept[-1] - kept[0] == kept.size - 1
        self._lines.append((kept.size, int(kept[0]) if is_contiguous else kept))

    def _convert(self, name: str, cells: Sequence[str]) -> _Block:
        if name in self._stamps:
            stamps = self._stamps[name].parse(cells)
            present = stamps[0] != MISSING
            return _Block(stamps, present, ~present & [any(map(str.isdigit, cell)) for cell in cells])
        values, bad = self._numerals.numbers(name, cells)
        return _Block(values, ~np.isnan(values), bad)

    def _error(self, name: str, cell: str, line: int) -> LogError:
        return LogError(self._path, expected(cell.strip(), self._numerals.sign), line=line, column=name)

    def content(self, units: Mapping[str, str | None]) -> Content:
        """Return the columns: name to numbers, stamps as seconds since the first."""
        row_count = sum(size for size, _ in self._lines)
        if not row_count:
            empty = LogError(self._path, "there are no samples below the header line", line=self._header)
            raise self._without_sample or empty
        try:
            self.notices += self._numerals.conclude()
        except CellError as error:
            raise LogError(self._path, error.problem, column=error.name) from error
        if self._without_sample is not None:
            self.notices.append(
                f"left out: {count(self._without_count, 'line')} without a sample, the first is line "
                f"{self._without_sample.line}"
            )
        channels = {}
        for name in list(self._values):
            bad_count, error = self._bad.get(name, (0, None))
            # Each column is released once it is joined: no more than one exists twice.
            values = np.concatenate(self._values.pop(name), axis=-1)
            if name in self._stamps:
                try:
                    values = self._stamps[name].seconds(values)
                except ValueError as calendar_error:
                    raise LogError(self._path, str(calendar_error), column=name) from calendar_error
            if error is None and np.all(np.isnan(values)):
                bad_count = row_count
                error = LogError(self._path, "holds no numbers; expected a number a line", column=name)
            if error is not None and bad_count > MAX_BAD_SHARE * row_count:
                if self._strict:
                    raise error
                continue
            if error is not None:
                self.notices.append(
                    f"{bad_count} of {row_count} cells of {name} are left out: {error.reason}"
                )
            values.setflags(write=False)
            channels[name] = LogChannel(values, "s" if name in self._stamps else units.get(name))
        return Content(self._path, channels, tuple(self.notices), partial(_line_of, self._lines))


def _line_of(line_blocks: Sequence[tuple[int, int | np.ndarray]], row: int) -> int | None:
    for size, lines in line_blocks:
        if row < size:
            return lines + row if isinstance(lines, int) else int(lines[row])
        row -= size
    return None
