"""The tables of a report as one workbook."""

from datetime import datetime
from io import BytesIO

from hitchid._support.data_table import DataTable
from hitchid.report.document import Document
from hitchid.report.renderers.renderer import Renderer

CREATED = datetime(2000, 1, 1)  # in the properties of every workbook: equal documents give equal bytes
MAX_WIDTH = 40  # of a column, characters; chosen
SHEET_NAME_LENGTH = 31  # largest number of characters of the name of a sheet in Excel
CONVERSIONS = ("strings_to_numbers", "strings_to_formulas", "strings_to_urls")  # none: text stays text


class Xlsx(Renderer):
    """Office Open XML workbook with one sheet for each table, numbers at full precision."""

    name, suffix = "xlsx", ".xlsx"
    package, extra = "xlsxwriter", "xlsx"

    def render(self, document: Document) -> bytes:
        """Return the tables of the document as a workbook."""
        from xlsxwriter import Workbook

        stream = BytesIO()
        with Workbook(stream, {"in_memory": True, **dict.fromkeys(CONVERSIONS, False)}) as workbook:
            workbook.set_properties({"title": document.title, "created": CREATED})
            heading = workbook.add_format({"bold": True, "bottom": 1})
            for table in document.data_tables.values():
                sheet = workbook.add_worksheet(table.name[:SHEET_NAME_LENGTH])
                sheet.write_row(0, 0, table.columns, heading)
                for number, row in enumerate(table.rows, start=1):
                    sheet.write_row(number, 0, row)
                sheet.freeze_panes(1, 1)
                for column, width in enumerate(_widths(table)):
                    sheet.set_column(column, column, width)
        return stream.getvalue()


def _widths(table: DataTable) -> list[int]:
    """Return the width of each column, in characters: that of its longest text."""
    texts = [
        [name, *(row[column] for row in table.rows if isinstance(row[column], str))]
        for column, name in enumerate(table.columns)
    ]
    return [min(MAX_WIDTH, max(len(str(text)) for text in column) + 2) for column in texts]
