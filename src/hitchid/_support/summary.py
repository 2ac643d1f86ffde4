"""What an object shows of itself: at most one screen of text, and in notebooks a table with a picture."""

import abc
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hitchid._support.inert import html_text, printable

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
        notes = [line for note in self.notes for line in wrapped(GAP, note)[:NOTE_LINES]]
        table = _table_lines([self.header, *self.rows])
        return screen([shortened(self.title), *table], notes)

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
    return "\n".join(_cut(printable(line)) for line in [*lines, *last])


def _cut(line: str) -> str:
    return line if len(line) <= MAX_WIDTH else f"{line[: MAX_WIDTH - 1]}…"


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


def _table_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:-1]
    widths = [min(width, MAX_WIDTH // 3) for width in widths]
    lines = []
    for *cells, last in rows:
        padded = [shortened(cell, width).ljust(width) for cell, width in zip(cells, widths, strict=True)]
        lines += wrapped(GAP + "".join(cell + GAP for cell in padded), last)
    return lines


def wrapped(start: str, text: str) -> list[str]:
    """Return a text in lines that fit on the screen, the first after `start`, the others indented as far."""
    lines = textwrap.wrap(" ".join(text.split()), max(MAX_WIDTH - len(start), MAX_WIDTH // 4)) or [""]
    return [(start + lines[0]).rstrip(), *(" " * len(start) + line for line in lines[1:])]


def _html_row(tag: str, cells: Iterable[str], end: str = "") -> str:
    style = ' style="text-align: left"'
    return "<tr>" + "".join(f"<{tag}{style}>{html_text(cell)}</{tag}>" for cell in cells) + end + "</tr>"
