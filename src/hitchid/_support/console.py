"""The terminal, to which what stands in a file writes nothing but text."""

from collections.abc import Iterator
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from hitchid._support.inert import printable


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
