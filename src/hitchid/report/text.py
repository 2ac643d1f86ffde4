"""A document as Markdown: uses, findings, notices and tables, without figures."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from io import BytesIO, StringIO
from textwrap import fill
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from rich import box

from hitchid._support.console import PlainConsole, line, rich_table
from hitchid._support.files import canonical_json
from hitchid._support.inert import markdown_text, printable, xml_bytes
from hitchid._support.tables import Cell
from hitchid.report.document import (
    Document,
    Equation,
    Finding,
    Findings,
    Renderer,
    ReportSection,
    Table,
    Text,
)
from hitchid.report.verdict import check_line

if TYPE_CHECKING:
    from xlsxwriter.format import Format
    from xlsxwriter.worksheet import Worksheet


# A document as text for a terminal: uses, verdict, short tables, acceptance limits.

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


# Acceptance limits as JUnit XML, for build servers.


class JUnit(Renderer):
    """JUnit XML, one test case for each acceptance limit."""

    name, suffix = "junit", ".xml"

    def render(self, document: Document) -> bytes:
        """Return the acceptance limits of the document as test cases.

        Characters that XML 1.0 does not permit become escapes; the text of a failure is that of `check_line`.
        """
        failures = sum(not check.passed for check in document.checks)
        counts = {
            "name": "hitchid",
            "tests": str(len(document.checks)),
            "failures": str(failures),
            "errors": "0",
        }
        root = ElementTree.Element("testsuites", counts)
        suite = ElementTree.SubElement(root, "testsuite", {**counts, "skipped": "0"})
        for check in document.checks:
            case = ElementTree.SubElement(
                suite, "testcase", {"classname": f"hitchid.{check.direction}", "name": check.name}
            )
            if not check.passed:
                message = {"message": f"{check.figure}, required {check.limit}", "type": "limit"}
                ElementTree.SubElement(case, "failure", message).text = check_line(check)
        return xml_bytes(root)


# The figures of a document as JSON.


class Json(Renderer):
    """JSON with sorted keys."""

    name, suffix = "json", ".json"

    def render(self, document: Document) -> bytes:
        """Return the content of `metrics.json` or `comparison.json`."""
        return canonical_json(document.data)


# The tables of a report as one workbook.

CREATED = datetime(2000, 1, 1)  # in the properties of every workbook: equal documents give equal bytes
MAX_WIDTH = 40  # of a column, characters; chosen
SHEET_NAME_LENGTH = 31  # largest number of characters of the name of a sheet in Excel
MAX_TEXT = 32_767  # characters of a cell in Excel; a longer text would be left out


class Xlsx(Renderer):
    """Office Open XML workbook with one sheet for each table, numbers at full precision."""

    name, suffix = "xlsx", ".xlsx"
    package, extra = "xlsxwriter", "xlsx"

    def render(self, document: Document) -> bytes:
        """Return the tables of the document as a workbook."""
        from xlsxwriter import Workbook

        stream = BytesIO()
        with Workbook(stream, {"in_memory": True}) as workbook:
            workbook.set_properties({"title": printable(document.title), "created": CREATED})
            heading = workbook.add_format({"bold": True, "bottom": 1})
            for table in document.data_tables.values():
                sheet = workbook.add_worksheet(table.name[:SHEET_NAME_LENGTH])
                for column, name in enumerate(table.columns):
                    _write(sheet, 0, column, name, heading)
                for number, row in enumerate(table.rows, start=1):
                    for column, cell in enumerate(row):
                        _write(sheet, number, column, cell)
                sheet.freeze_panes(1, 1)
                for column, name in enumerate(table.columns):
                    texts = [name, *(row[column] for row in table.rows if isinstance(row[column], str))]
                    widest = max(len(str(text)) for text in texts)
                    sheet.set_column(column, column, min(MAX_WIDTH, widest + 2))
        return stream.getvalue()


def _write(sheet: "Worksheet", row: int, column: int, cell: Cell, style: "Format | None" = None) -> None:
    """Write a cell; text as text, whatever it looks like."""
    if isinstance(cell, str):
        sheet.write_string(row, column, printable(cell)[:MAX_TEXT], style)
    else:
        sheet.write(row, column, cell, style)


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
