"""A renderer for hitchid: the tables of a report as CSV, one after another."""

import csv
from io import StringIO

from hitchid.report import Document, Renderer


class CsvTables(Renderer):
    """Each table: a line with its title, its header, its rows, an empty line."""

    name, suffix = "csv", ".csv"

    def render(self, document: Document) -> bytes:
        """Return every table of the document."""
        stream = StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        for table in document.tables:
            writer.writerows([[table.title], table.header, *table.rows, []])
        return stream.getvalue().encode("utf-8", errors="replace")


CSV_TABLES = CsvTables()
