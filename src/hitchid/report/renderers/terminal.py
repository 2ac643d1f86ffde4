"""A document as text for a terminal: uses, verdict, short tables, acceptance limits."""

from io import StringIO
from textwrap import fill

from rich import box
from rich.table import Table as RichTable

from hitchid._support.console import PlainConsole, line
from hitchid.report.document import Document, Table
from hitchid.report.renderers.renderer import Renderer

COLUMNS = 80  # width of a terminal, characters


class Terminal(Renderer):
    """Plain text in lines of 80 characters."""

    name, suffix = "terminal", ".txt"

    def render(self, document: Document) -> bytes:
        """Return uses, verdict and summary of the document, without colours."""
        stream = StringIO()
        for use in document.uses:
            stream.write(line(fill(use, COLUMNS, subsequent_indent="  ", break_on_hyphens=False)))
        for finding in document.verdict:
            text = f"{finding.level.value:8}{finding.sentence}"
            stream.write(line(fill(text, COLUMNS, subsequent_indent=" " * 8, break_on_hyphens=False)))
        console = PlainConsole(file=stream, width=COLUMNS)
        for table in document.summary:
            console.print(rich_table(table, kind=box.SIMPLE_HEAD))
        return stream.getvalue().encode("utf-8", errors="replace")


def rich_table(table: Table, *, kind: box.Box = box.HEAVY_HEAD) -> RichTable:
    """Return a table for rich; columns of numbers are aligned on the right."""
    content = RichTable(
        title=table.title or None,
        title_justify="left",
        title_style="bold",
        box=kind,
        pad_edge=bool(table.title),
    )
    for name, right in zip(table.header, table.numeric, strict=True):
        content.add_column(name, justify="right" if right else "left")
    for row in table.rows:
        content.add_row(*row)
    return content
