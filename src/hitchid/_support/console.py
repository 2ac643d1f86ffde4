"""The terminal, to which what stands in a file writes nothing but text."""

from collections.abc import Iterator
from typing import Any

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table as RichTable
from rich.text import Text

from hitchid._support.inert import printable
from hitchid._support.tables import Faint, Table


class PlainConsole(Console):
    """A console of rich that takes no markup, and shows characters that act on a terminal as escapes."""

    def __init__(self, **options: Any):
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yield the segments of an object; escape sequences of its style and of the cursor are rich's own."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def line(text: str) -> str:
    """Return text and a line break, to be written to standard output or standard error."""
    return f"{printable(text)}\n"


def rich_table(table: Table, *, kind: box.Box = box.HEAVY_HEAD, align: bool = True) -> RichTable:
    """Return a table for rich; with `align` columns of numbers are aligned on the right."""
    content = RichTable(
        title=table.title or None,
        title_justify="left",
        title_style="bold",
        box=kind,
        pad_edge=bool(table.title),
    )
    for name, right in zip(table.header, table.numeric, strict=True):
        content.add_column(name, justify="right" if right and align else "left")
    for row in table.rows:
        content.add_row(*(Text(cell, "dim") if isinstance(cell, Faint) else cell for cell in row))
    return content
