"""The page: HTML that is well formed, that anyone can find their way in, and that needs nothing else."""

import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from importlib.util import find_spec
from itertools import pairwise

import pytest

import reported
from hitchid._support.tables import DataTable
from hitchid.report import ReportSection, Table, render

# Elements that have no end, in HTML.
VOID = {"meta", "link", "br", "hr", "img", "input"}


class Element:
    """One element of a page: its tag, attributes, parent, and what is inside it in order."""

    def __init__(self, tag, attributes, parent):
        self.tag, self.attributes, self.parent, self.inside = tag, dict(attributes), parent, []

    def all(self, *tags):
        """Yield every element within, of some tags."""
        for part in self.inside:
            if isinstance(part, Element):
                if not tags or part.tag in tags:
                    yield part
                yield from part.all(*tags)

    @property
    def text(self):
        return "".join(part if isinstance(part, str) else part.text for part in self.inside)

    def __getitem__(self, name):
        return self.attributes[name]

    def get(self, name, default=None):
        return self.attributes.get(name, default)


class Reader(HTMLParser):
    """Reads a page into elements and notes every tag that is not closed where it was opened."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.root = self.here = Element("", {}, None)
        self.faults = []
        self.feed(text)
        self.close()
        if self.here is not self.root:
            self.faults.append(f"{self.here.tag} never ends")

    def handle_starttag(self, tag, attrs):
        if len({name for name, _ in attrs}) < len(attrs):
            self.faults.append(f"{tag} has an attribute twice")
        element = Element(tag, attrs, self.here)
        self.here.inside.append(element)
        if tag not in VOID:
            self.here = element

    def handle_startendtag(self, tag, attrs):
        self.here.inside.append(Element(tag, attrs, self.here))

    def handle_endtag(self, tag):
        if tag != self.here.tag:
            self.faults.append(f"line {self.getpos()[0]}: </{tag}> ends {self.here.tag}")
        self.here = self.here.parent or self.root

    def handle_data(self, data):
        self.here.inside.append(data)


def page(document):
    """Return a report as text; its figures are all the same one."""
    for picture in document.pictures:
        vars(picture)["svg"] = small_figure()
    return render(document, "html").decode()


@cache
def small_figure():
    """Return a figure as a file."""
    return reported.picture().svg


def read(text):
    """Return a page as elements, well formed."""
    reader = Reader(text)
    assert reader.faults == []
    return reader.root


@pytest.fixture(scope="module")
def text():
    """Return a page with a block of every kind."""
    return page(reported.document())


@pytest.fixture(scope="module")
def root(text):
    return read(text)


# --- how it is built ----------------------------------------------------------------------------------------


def test_a_page_is_html_with_charset_title_and_language(text, root):
    assert text.lstrip().startswith("<!doctype html>")
    (whole,) = root.all("html")
    assert whole["lang"] == "en"
    assert any(meta.get("charset") == "utf-8" for meta in root.all("meta"))
    assert any("width=device-width" in meta.get("content", "") for meta in root.all("meta"))
    (title,) = root.all("title")
    assert title.text == "A report"


def test_headings_begin_at_the_first_level_and_skip_none(root):
    levels = [int(heading.tag[1]) for heading in root.all("h1", "h2", "h3", "h4", "h5", "h6")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert max(levels) == 4
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_identifiers_differ_and_links_lead_to_sections(root):
    identifiers = [element["id"] for element in root.all() if element.get("id") is not None]
    assert len(identifiers) == len(set(identifiers))
    assert not any(re.search(r"\s", identifier) for identifier in identifiers)
    (nav,) = root.all("nav")
    links = list(nav.all("a"))
    sections = {section["id"]: section for section in root.all("section")}
    assert [link.text for link in links] == ["Verdict", "Mixed cycles", "Logs"]
    for link in links:
        assert link["href"].startswith("#")
        heading = next(sections[link["href"][1:]].all("h2"))
        assert heading.text == link.text


def test_sections_of_one_name_have_identifiers_of_their_own():
    both = tuple(
        ReportSection(mode, sections=(ReportSection("Trust"), ReportSection("Errors")))
        for mode in ("Up", "Down")
    )
    root = read(page(replace(reported.document(), sections=both)))
    identifiers = [section["id"] for section in root.all("section")]
    assert len(set(identifiers)) == 7


# --- tables -------------------------------------------------------------------------------------------------


def test_a_table_has_a_caption_scoped_headers_and_every_cell(root):
    tables = list(root.all("table"))
    assert len(tables) == 2
    for table in tables:
        caption = next(table.all("caption"))
        assert caption.text == "Lifting: accuracy"
        head, body = next(table.all("thead")), next(table.all("tbody"))
        assert [cell.text for cell in head.all("th")] == list(reported.TABLE.header)
        assert {cell["scope"] for cell in head.all("th")} == {"col"}
        rows = [list(row.all("th", "td")) for row in body.all("tr")]
        assert [tuple(cell.text for cell in row) for row in rows] == list(reported.TABLE.rows)
        for first, *others in rows:
            assert (first.tag, first["scope"]) == ("th", "row")
            assert {cell.tag for cell in others} == {"td"}


def test_a_table_without_a_row_is_still_a_table():
    empty = Table("lifting: nothing", ("model", "RMSE / mm"), ())
    (table, _) = read(page(reported.document(table=empty))).all("table")
    assert [cell.text for cell in next(table.all("thead")).all("th")] == ["model", "RMSE / mm"]


# --- figures ------------------------------------------------------------------------------------------------


def test_a_figure_has_a_caption_and_image_with_text(root):
    figures = list(root.all("figure"))
    assert [figure["id"] for figure in figures] == ["figure-curve", "figure-long"]
    for figure in figures:
        assert next(figure.all("figcaption")).text == "What is seen."
        (image,) = figure.all("svg")
        assert image["role"] == "img"
        assert image["aria-label"] == "Error over the horizon."


def test_only_named_regions_that_scroll_are_reached_by_keyboard(root):
    narrow, wide = root.all("figure")
    assert not any(element.get("tabindex") for element in narrow.all())
    assert next(wide.all("div"))["tabindex"] == "0"
    for table in root.all("table"):
        assert (table.parent["tabindex"], table.parent["aria-label"]) == ("0", reported.TABLE.title)
    for element in root.all():
        if element.get("tabindex") is not None:
            assert (element["tabindex"], element["role"]) == ("0", "region")
            assert element["aria-label"]


# --- nothing from outside, nothing that runs ----------------------------------------------------------------


def test_a_page_runs_nothing_and_asks_for_nothing(text, root):
    assert "<script" not in text
    assert "@import" not in text
    for element in root.all():
        assert not [name for name in element.attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href", "srcset", "action", "data"):
            target = element.get(name)
            assert target is None or target.startswith(("#", "data:")), (element.tag, target)
    assert all(target.startswith("#") for target in re.findall(r"url\(['\"]?([^)'\"]+)", text))
    assert not re.search(r"https?://", text)


@pytest.mark.parametrize(("renderer", "package"), [("html", None), ("pdf", "typst"), ("xlsx", "xlsxwriter")])
def test_equal_reports_give_equal_bytes(renderer, package):
    if package and find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    tables = {"t": DataTable("t", ("a", "b"), ((0.1, "up"),))}
    one, other = (render(replace(reported.document(), data_tables=tables), renderer) for _ in range(2))
    assert one == other


def test_the_verdict_stands_first_its_ratings_as_words_too(root):
    (main,) = root.all("main")
    first = next(main.all("section"))
    assert first["id"] == "verdict"
    *sentences, notice = [item.text for item in first.all("li")]
    for sentence, finding in zip(sentences, reported.FINDINGS, strict=True):
        # A sign and a colour alone say nothing to who cannot see them.
        assert finding.level.value in sentence
        assert finding.sentence in sentence
    assert notice == "Mind the gap."
    signs = [span for span in root.all("span") if span.get("class") == "sign"]
    assert len(signs) == 3 * len(reported.FINDINGS)
    assert {sign.get("aria-hidden") for sign in signs} == {"true"}
    assert len({sign.text for sign in signs}) == 3


def test_columns_of_numbers_stand_right_head_and_cells(root):
    table = next(root.all("table"))
    header = next(table.all("thead")).all("th")
    right = [cell.get("class") == "number" for cell in header]
    assert right == [False, True, True, True, False]
    for row in next(table.all("tbody")).all("tr"):
        assert [cell.get("class") == "number" for cell in row.all("th", "td")] == right


@pytest.mark.parametrize(
    ("cells", "right"),
    [
        (("1", "-2.5"), True),
        (("41.85 ± 0.30", ""), True),
        (("1.2 … 3.4", "> 988", "< 0.05"), True),
        (("diverged", "0.5"), True),
        (("any", "1"), True),
        (("1e-05", "2.5e+07"), True),
        (("100.0 %", "3"), True),
        (("", ""), False),
        (("grey box", "1"), False),
        (("determined", "determined"), False),
        (("1 of 8", "2"), False),
        (("mm", "s"), False),
        (("4f2a9b0e11111111", "4111111111111111"), False),
    ],
)
def test_a_column_of_numbers_has_numbers_only(cells, right):
    is_numeric = Table("", ("name", "value"), tuple(("row", cell) for cell in cells)).numeric
    assert is_numeric == [False, right]
