"""Hostile names and units in every kind of report: no element, formula, link or program begins in them."""

import io
import json
import re
import warnings
import zipfile
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

import fleet_rows
from hitchid._support.inert import printable
from hitchid._support.tables import DataTable
from hitchid.fleet import compare_fleet, figures
from hitchid.model import LoadScatter
from hitchid.model.estimates import LoadOfTest
from hitchid.plots.style import canvas, styled
from hitchid.report.document import (
    Document,
    Finding,
    Findings,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Signals,
    Table,
    Text,
)
from hitchid.report.figures import loads as loads_figure
from hitchid.report.svg import svg
from hitchid.report.write import render
from hitchid.validation import Check, Predictions
from hostile import HTML, MATHEMATICS, STRINGS, TERMINAL, UNICODE, acts

BENIGN = ("name",) * len(STRINGS)
PICTURED = [text[:40] for text in (*MATHEMATICS, *HTML[::3], *TERMINAL[::2], *UNICODE[::2])]


class Elements(HTMLParser):
    """Names of the elements and attributes of a page but in its figures, and its texts."""

    def __init__(self, page: str):
        super().__init__()
        self.elements, self.texts, self.in_figure = [], [], False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        if not self.in_figure:
            self.elements.append((tag, tuple(name for name, _ in attrs)))
        self.in_figure |= tag == "svg"

    def handle_endtag(self, tag):
        self.in_figure &= tag != "svg"

    def handle_data(self, data):
        self.texts.append(data)


@styled
def figure(texts) -> Figure:
    """Return a figure with a title, a label and a tick of each text."""
    made = Figure(figsize=(20, 20))
    axes = made.subplots()
    for text in texts:
        axes.text(0.1, 0.1, text)
    axes.set_title(texts[0])
    axes.set_xlabel(f"{texts[1]} / {texts[2]}")
    axes.set_yticks(range(8), [printable(text)[:20] for text in texts[-8:]])
    axes.plot([0, 1], label=texts[3])
    axes.legend()
    return made


def document(texts, pictured) -> Document:
    """Return a document with each text at every place."""
    findings = tuple(Finding(Rating.BAD, text) for text in texts)
    picture = Picture("picture", figure(pictured), texts[0], texts[1], data={texts[2]: [1.0]})
    table = Table(texts[3], (texts[4], "b"), tuple((text, text) for text in texts))
    section = ReportSection(
        texts[5], (Text(texts[6]), *map(Text, texts), Findings(findings), table, Pictures((picture,)))
    )
    rows = (np.arange(3.0),) * len(texts)
    tests = Predictions(tuple(texts), rows, rows, {"free_run": rows})
    return Document(
        texts[0],
        texts[1],
        findings,
        tuple(texts),
        (section,),
        (table,),
        data={text: text for text in texts},
        data_tables={"names": DataTable("names", (texts[0], "b"), tuple((text, 1.0) for text in texts))},
        signals=Signals({"lifting": tests}, texts[7], {}),
        checks=tuple(Check("lifting", text, "1", text, False) for text in texts),
    )


@pytest.fixture(scope="module")
def documents():
    """Return a document of hostile texts, and one of harmless ones."""
    return document(STRINGS, PICTURED), document(BENIGN, BENIGN[:9])


def assert_inert(text):
    """Assert that no character of a text acts on a terminal."""
    assert not {character for character in text if acts(character)} - {"\n", "\t"}


def test_a_page_has_the_elements_of_one_with_harmless_texts(documents):
    hostile, benign = (Elements(render(made, "html").decode()) for made in documents)
    assert hostile.elements == benign.elements
    shown = " ".join(" ".join(hostile.texts).split())
    assert all(" ".join(printable(text).split()) in shown for text in STRINGS)
    assert_inert("".join(hostile.texts))


def test_the_data_of_an_interactive_page_stay_data(documents):
    hostile, benign = (render(made, "interactive").decode() for made in documents)
    assert Elements(hostile).elements == Elements(benign).elements
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', hostile, re.DOTALL)
    assert [test["name"] for test in json.loads(data)["sections"]["lifting"]] == list(map(printable, STRINGS))


def test_a_figure_is_xml_with_elements_of_a_harmless_one(documents):
    hostile, benign = (ElementTree.fromstring(made.pictures[0].svg) for made in documents)  # noqa: S314 - our own
    # Each line of a text is an element of its own.
    permitted = {element.tag for element in benign.iter()} | {"{http://www.w3.org/2000/svg}tspan"}
    assert {element.tag for element in hostile.iter()} <= permitted
    texts = {"".join(element.itertext()) for element in hostile.iter("{http://www.w3.org/2000/svg}text")}
    assert set(MATHEMATICS) <= texts


def test_the_callers_axes_take_hostile_units_and_keep_their_texts():
    figure = Figure()
    axes = figure.subplots(1, 2)
    axes[0].set_title("$x^2$")
    with canvas(axes, 1, 2, height_in=2.0) as drawn:
        for own in drawn:
            own.plot([0, 1], label="$\\frac$")
            own.set_ylabel("displacement / $\\undefined$ \x1b")
    figure.savefig(io.BytesIO(), format="png")
    assert axes[0].get_ylabel() == "displacement / $\\undefined$ \\u001b"
    assert axes[0].title.get_parse_math()


def test_a_table_of_markdown_keeps_its_cells(documents):
    text = render(documents[0], "markdown").decode()
    rows = [line for line in text.split("\n") if line.startswith("| ")]
    assert len(rows) == len(STRINGS) + 2
    assert {len(re.findall(r"(?<!\\)(?:\\\\)*\|", row)) for row in rows} == {3}
    for mark in "<`[":
        assert not re.search(rf"(?<!\\)(?:\\\\)*{re.escape(mark)}", text)
    assert_inert(text)


def test_text_for_a_terminal_and_junit_have_no_control_characters(documents):
    assert_inert(render(documents[0], "terminal").decode())
    suite = ElementTree.fromstring(render(documents[0], "junit"))  # noqa: S314 - our own
    assert [case.get("name") for case in suite.iter("testcase")] == [printable(text) for text in STRINGS]


def test_a_workbook_has_no_formulas_and_a_pdf_is_made(documents):
    pytest.importorskip("xlsxwriter")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        content = render(documents[0], "xlsx")
    with zipfile.ZipFile(io.BytesIO(content)) as workbook:
        roots = {name: ElementTree.fromstring(workbook.read(name)) for name in workbook.namelist()}  # noqa: S314
    sheet = roots["xl/worksheets/sheet1.xml"]
    space = sheet.tag.removesuffix("worksheet")
    assert not list(sheet.iter(f"{space}f"))
    assert not [name for name in roots if "externalLink" in name or name.endswith("sheet1.xml.rels")]
    cells = list(sheet.iter(f"{space}c"))
    assert {cell.get("t") for cell in cells[::2] if cell.find(f"{space}v") is not None} == {"s"}
    assert [float(cell.find(f"{space}v").text) for cell in cells[3::2]] == [1.0] * len(STRINGS)
    pytest.importorskip("typst")
    assert render(documents[0], "pdf").startswith(b"%PDF")


def test_names_of_tests_and_machines_are_no_mathematics():
    loads = tuple(LoadOfTest(name[:40], 0.01, (0.0, 0.02)) for name in (*MATHEMATICS, *UNICODE[:12]))
    faults = {MATHEMATICS.index("$\\frac$"): {"gain_factor": 0.8}}
    machines = fleet_rows.fleet(len(MATHEMATICS), faults=faults, name=MATHEMATICS.__getitem__)
    for drawn in (
        loads_figure("name", LoadScatter(0.03, (0.01, 0.05), 0.1, loads)).figure,
        figures.verdicts(compare_fleet(machines)),
    ):
        root = ElementTree.fromstring(svg(drawn))  # noqa: S314 - our own
        shown = {"".join(element.itertext()) for element in root.iter("{http://www.w3.org/2000/svg}text")}
        assert "$\\frac$" in shown
