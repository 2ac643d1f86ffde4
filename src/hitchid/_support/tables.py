"""Tables of results as data: numbers at full precision, units in the names of the columns."""

import abc
import csv
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support.inert import html_text, printable, spreadsheet_text
from hitchid.errors import InputError

if TYPE_CHECKING:
    from pandas import DataFrame


# Tables as pandas DataFrames; pandas is imported only where one is requested.


def dataframe(table: Mapping[str, object] | Sequence[Mapping[str, object]]) -> "DataFrame":
    """Return columns, or rows that are column name to value, as a DataFrame; None becomes a missing value.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError("pandas is required for DataFrames: pip install 'hitchid[pandas]'") from error
    return pd.DataFrame(dict(table) if isinstance(table, Mapping) else list(table))


# What an object shows of itself: at most one screen of text, and in notebooks a table with a picture.

MAX_LINES, MAX_WIDTH = 25, 110  # lines and characters of a screen; chosen
NOTE_LINES, NAME_WIDTH = 3, 24  # lines of a note; characters of a name among others; chosen
GAP = "  "  # between columns


@dataclass(frozen=True)
class Summary:
    """A title, a table and notes.

    Attributes:
        title: one sentence without full stop.
        header, rows: texts of the cells; the last column is wrapped.
        notes: sentences below the table, as text at most three lines each.
        pictures: SVG element of each row, shown in HTML only; empty for none.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    pictures: tuple[str, ...] = ()

    def text(self) -> str:
        """Return at most 25 lines of at most 110 characters."""
        rows = [self.header, *self.rows]
        widths = [min(max(map(len, column)), MAX_WIDTH // 3) for column in zip(*rows, strict=True)][:-1]
        lines = [shortened(self.title)]
        for *cells, last in rows:
            padded = [shortened(cell, width).ljust(width) for cell, width in zip(cells, widths, strict=True)]
            lines += wrapped(GAP + "".join(cell + GAP for cell in padded), last)
        notes = [line for note in self.notes for line in wrapped(GAP, note)[:NOTE_LINES]]
        return screen(lines, notes)

    def html(self) -> str:
        """Return an HTML element with the table; text is escaped, colours are those of the page."""
        head = _html_row("th", [*self.header, *([""] if self.pictures else [])])
        pictures = self.pictures or ("",) * len(self.rows)
        rows = "".join(
            _html_row("td", row, f"<td>{picture}</td>" if self.pictures else "")
            for row, picture in zip(self.rows, pictures, strict=True)
        )
        notes = "".join(f"<div>{html_text(note)}</div>" for note in self.notes)
        return (
            f"<div><strong>{html_text(self.title)}</strong>"
            f"<table><thead>{head}</thead><tbody>{rows}</tbody></table>{notes}</div>"
        )


class Summarised(abc.ABC):
    """Base of an object that shows its summary; a dataclass is declared with `repr=False`."""

    @abc.abstractmethod
    def _summary(self) -> Summary:
        """Return what is shown."""

    def __repr__(self) -> str:
        """Return the summary as text, at most 25 lines."""
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


def screen(lines: Sequence[str], last: Sequence[str] = ()) -> str:
    """Return lines and last lines as text; lines too many are counted instead, long ones are cut."""
    last = last[: MAX_LINES // 2]
    room = MAX_LINES - len(last)
    if len(lines) > room:
        lines = [*lines[: room - 1], f"{GAP}… {len(lines) - room + 1} more lines"]
    texts = [printable(line) for line in [*lines, *last]]
    return "\n".join(text if len(text) <= MAX_WIDTH else f"{text[: MAX_WIDTH - 1]}…" for text in texts)


def shortened(text: str, width: int = MAX_WIDTH) -> str:
    """Return a text on one line, cut with an ellipsis where it is longer than `width` characters."""
    line = " ".join(printable(text).split())
    return line if len(line) <= width else f"{line[: width - 1]}…"


def count(number: int, noun: str) -> str:
    """Return a number with a noun, in the plural unless the number is 1."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def first_notes(notes: Sequence[str], maximum: int, attribute: str) -> tuple[str, ...]:
    """Return the first notes, and how many more an attribute of the object holds."""
    more = len(notes) - maximum
    return (*notes[:maximum], *([f"and {more} more: see .{attribute}"] if more > 0 else []))


def first_to_last(names: Sequence[str]) -> str:
    """Return one or two names, or the first and the last of more."""
    shown = [shortened(name, NAME_WIDTH) for name in (names if len(names) <= 2 else (names[0], names[-1]))]
    return (", " if len(names) <= 2 else " … ").join(shown)


def wrapped(start: str, text: str) -> list[str]:
    """Return a text in lines that fit on the screen, the first after `start`, the others indented as far."""
    lines = textwrap.wrap(" ".join(text.split()), max(MAX_WIDTH - len(start), MAX_WIDTH // 4)) or [""]
    return [(start + lines[0]).rstrip(), *(" " * len(start) + line for line in lines[1:])]


def _html_row(tag: str, cells: Iterable[str], end: str = "") -> str:
    style = ' style="text-align: left"'
    return "<tr>" + "".join(f"<{tag}{style}>{html_text(cell)}</{tag}>" for cell in cells) + end + "</tr>"


# A small picture of curves as one SVG element, in the colour of the text around it.

WIDTH, HEIGHT, MARGIN = 220, 48, 2  # pixels; chosen
COLUMNS = 55  # of the picture, one for four pixels: each shows the least and the largest sample in it
OPACITIES = (1.0, 0.45, 0.25)  # of the first curve and those below it; chosen


def sparkline(curves: Sequence[np.ndarray], label: str, scales: Sequence[np.ndarray] | None = None) -> str:
    """Return curves over their sample number.

    Args:
        curves: the first is drawn strongest; each of shape [N].
        label: text for screen readers.
        scales: for each curve the values between whose least and largest it is drawn; by default its own.
    """
    lines = []
    for curve, scale, opacity in zip(curves, scales or curves, OPACITIES, strict=False):
        positions, values = _thinned(curve)
        ends = scale[np.isfinite(scale)]
        if not values.size or not ends.size:
            continue
        lowest, span = ends.min(), np.ptp(ends) or 1.0
        x = MARGIN + (WIDTH - 2 * MARGIN) * positions
        y = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * np.clip((values - lowest) / span, 0.0, 1.0)
        points = " ".join(f"{left:.0f},{top:.1f}" for left, top in zip(x, y, strict=True))
        lines.append(f'<polyline points="{points}" stroke-opacity="{opacity}"/>')
    return (
        f'<svg role="img" aria-label="{html_text(label)}" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" fill="none" stroke="currentColor">{"".join(reversed(lines))}</svg>'
    )


def _thinned(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions from 0 to 1 and values: in each column of the picture the least and the largest."""
    samples = np.asarray(curve, dtype=np.float64)
    rows = np.flatnonzero(np.isfinite(samples))
    if rows.size > 2 * COLUMNS:
        columns = np.array_split(rows, COLUMNS)
        extremes = [(part[samples[part].argmin()], part[samples[part].argmax()]) for part in columns]
        rows = np.unique(extremes)
    return rows / max(1, samples.size - 1), samples[rows]


TABLES = "tables"  # folder of the CSV files in a folder of results
Cell = str | float | int | bool | None


@dataclass(frozen=True, repr=False)
class DataTable:
    """One table of results.

    Attributes:
        name: of its file without suffix, and of its sheet in a workbook.
        columns: names with units, such as `rmse_mm`.
        rows: cells in the order of the columns; None where there is no value.
    """

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @classmethod
    def of_rows(cls, name: str, rows: Iterable[Mapping[str, Cell]]) -> "DataTable":
        """Return a table of rows, each column to value; columns in the order of their first appearance."""
        all_rows = list(rows)
        columns = tuple(dict.fromkeys(column for row in all_rows for column in row))
        return cls(name, columns, tuple(tuple(row.get(column) for column in columns) for row in all_rows))

    @classmethod
    def of_columns(cls, name: str, columns: Mapping[str, Sequence[Cell] | np.ndarray]) -> "DataTable":
        """Return a table of columns; shorter ones end with empty cells."""
        cells = [values.tolist() if isinstance(values, np.ndarray) else values for values in columns.values()]
        return cls(name, tuple(columns), tuple(zip_longest(*cells)))

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return shortened(f"DataTable({self.name!r}: {len(self.rows)} rows of {', '.join(self.columns)})")

    def csv(self) -> bytes:
        """Return the table as CSV in UTF-8: numbers as read back exactly, empty cells for no value."""
        stream = StringIO(newline="")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(map(spreadsheet_text, self.columns))
        writer.writerows([_text(cell) for cell in row] for row in self.rows)
        return stream.getvalue().encode("utf-8", errors="replace")

    def to_dataframe(self) -> "DataFrame":
        """Return the table as a pandas DataFrame.

        Raises:
            InputError: pandas is not installed.
        """
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return dataframe(rows).reindex(columns=list(self.columns))


def stacked(tables: Mapping[str, Mapping[str, DataTable]], key: str) -> dict[str, DataTable]:
    """Return tables of the same name below each other, with a first column for their origin.

    Args:
        tables: origin to name to table.
        key: name of the first column.
    """
    rows: dict[str, list[Mapping[str, Cell]]] = {}
    for origin, by_name in tables.items():
        for name, table in by_name.items():
            rows.setdefault(name, []).extend(
                {key: origin, **dict(zip(table.columns, row, strict=True))} for row in table.rows
            )
    return {name: DataTable.of_rows(name, table_rows) for name, table_rows in rows.items()}


def csv_files(tables: Iterable[DataTable], folder: str = TABLES) -> dict[str, bytes]:
    """Return the CSV file of each table, `folder/name.csv` to content."""
    return {f"{folder}/{table.name}.csv": table.csv() for table in tables}


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    return repr(float(cell)) if isinstance(cell, float) else spreadsheet_text(str(cell))
