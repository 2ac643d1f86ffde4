"""The tables of a report as one workbook."""

from datetime import datetime
from io import BytesIO
from typing import TYPE_CHECKING

from hitchid._support.data_table import Cell, DataTable
from hitchid._support.inert import printable
from hitchid.report.document import Document
from hitchid.report.renderers.renderer import Renderer

if TYPE_CHECKING:
    from xlsxwriter.format import Format
    from xlsxwriter.worksheet import Worksheet

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
                for column, width in enumerate(_widths(table)):
                    sheet.set_column(column, column, width)
        return stream.getvalue()


def _write(sheet: "Worksheet", row: int, column: int, cell: Cell, style: "Format | None" = None) -> None:
    """Write a cell; text as text, whatever it looks like."""
    if isinstance(cell, str):
        sheet.write_string(row, column, printable(cell)[:MAX_TEXT], style)
    else:
        sheet.write(row, column, cell, style)


def _widths(table: DataTable) -> list[int]:
    """Return the width of each column, in characters: that of its longest text."""
    texts = [
        [name, *(row[column] for row in table.rows if isinstance(row[column], str))]
        for column, name in enumerate(table.columns)
    ]
    return [min(MAX_WIDTH, max(len(str(text)) for text in column) + 2) for column in texts]
