"""A document as Markdown: uses, findings, notices and tables, without figures."""

from collections.abc import Iterator, Sequence

from hitchid._support.inert import markdown_text
from hitchid.report.document import Document, Equation, Finding, Findings, ReportSection, Table, Text
from hitchid.report.renderers.renderer import Renderer


class Markdown(Renderer):
    """Markdown with tables."""

    name, suffix = "markdown", ".md"

    def render(self, document: Document) -> bytes:
        """Return the document as UTF-8; characters that cannot be encoded are escaped."""
        lines = [f"# {markdown_text(document.title)}", ""]
        lines += [line for use in document.uses for line in (markdown_text(use), "")]
        items = [*_items(document.verdict), *(f"- {markdown_text(notice)}" for notice in document.notices)]
        lines += [*items, ""] if items else []
        for section in document.sections:
            lines += _section(section, 2)
        return "\n".join(lines).encode("utf-8", errors="backslashreplace")


def _items(findings: Sequence[Finding]) -> list[str]:
    return [f"- {finding.level.value}: {markdown_text(finding.sentence)}" for finding in findings]


def _section(section: ReportSection, level: int) -> Iterator[str]:
    """Yield the lines of a section; without a title its tables belong to the level above."""
    if section.title:
        yield from (f"{'#' * level} {markdown_text(section.title)}", "")
        level += 1
    for block in section.blocks:
        match block:
            case Text(text) | Equation(text=text):
                yield from (markdown_text(text), "")
            case Findings(items):
                yield from (*_items(items), "")
            case Table():
                yield from _table(block, level)
            case _:
                continue
    for below in section.sections:
        yield from _section(below, level)


def _table(table: Table, level: int) -> Iterator[str]:
    yield from (f"{'#' * level} {markdown_text(table.title)}", "")
    yield f"| {' | '.join(map(markdown_text, table.header))} |"
    yield f"| {' | '.join(['---', *('---:' for _ in table.header[1:])])} |"
    for row in table.rows:
        yield f"| {' | '.join(map(markdown_text, row))} |"
    yield ""
