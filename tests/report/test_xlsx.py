"""The workbook: a sheet for each table with its numbers as numbers and its texts as texts."""

import zipfile
from io import BytesIO
from xml.etree import ElementTree

import pytest

from hitchid._support.tables import DataTable
from hitchid.report import Document, render

SPACE = {"": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}
TABLES = (
    DataTable(
        "lifting-tests", ("test", "rmse_mm", "white"), (("=1+1", 0.1 + 0.2, True), ("up", None, False))
    ),
    DataTable("lifting-residuals-by-quantity-and-more", ("a",), ((1e-300,),)),
)


@pytest.fixture
def archive():
    pytest.importorskip("xlsxwriter", reason="xlsxwriter is not installed; pip install 'hitchid[xlsx]'")
    document = Document("Validation", data_tables={table.name: table for table in TABLES})
    return zipfile.ZipFile(BytesIO(render(document, "xlsx")))


def tree(archive, name):
    return ElementTree.fromstring(archive.read(name))  # noqa: S314 - our own


def test_each_table_is_a_sheet_named_within_excels_length(archive):
    names = [element.get("name") for element in tree(archive, "xl/workbook.xml").iterfind(".//sheet", SPACE)]
    assert names == ["lifting-tests", "lifting-residuals-by-quantity-a"]


def test_numbers_keep_full_precision_and_no_text_is_a_formula(archive):
    texts = ["".join(element.itertext()) for element in tree(archive, "xl/sharedStrings.xml")]
    sheet = tree(archive, "xl/worksheets/sheet1.xml")
    assert sheet.find(".//f", SPACE) is None
    cells = {
        element.get("r"): (element.get("t"), element.findtext("v", None, SPACE))
        for element in sheet.iterfind(".//c", SPACE)
    }
    assert [texts[int(cells[f"{column}1"][1])] for column in "ABC"] == list(TABLES[0].columns)
    assert texts[int(cells["A2"][1])] == "=1+1"
    kind, number = cells["B2"]
    assert kind is None
    assert float(number) == pytest.approx(0.1 + 0.2, rel=1e-15)
    assert "B3" not in cells
    assert cells["C2"] == ("b", "1")
