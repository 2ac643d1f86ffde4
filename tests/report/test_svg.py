"""A figure as SVG: the same bytes each time, and in a page its own names, the page's colours, and a text."""

import re
from html import escape
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

import reported
from hitchid._support.inert import printable
from hitchid.plots.style import COLOURS, SHADES
from hitchid.report.svg import inline_svg, svg
from reported import sketch

SVG, XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"
DRAWN = {
    "outputs": ("outputs", reported.predictions((900, 800)), "mm", reported.PAPER),
    "intervals": ("intervals", "title", reported.ESTIMATES),
    "correlations": ("residual_correlations", reported.residuals()),
    "distribution": ("error_distribution", {"free_run": np.arange(9.0)}, "mm"),
}


@pytest.fixture(scope="module")
def files():
    """Return each figure as a file."""
    return {name: svg(sketch(*arguments)) for name, arguments in DRAWN.items()}


@pytest.fixture(scope="module")
def page(files):
    """Return all figures as they stand in one page, in an element that names the namespaces."""
    inside = [inline_svg(text, name, f"what {name} shows") for name, text in files.items()]
    return f'<div xmlns="{SVG[1:-1]}" xmlns:xlink="{XLINK[1:-1]}">{"".join(inside)}</div>'


def references(text):
    """Return the identifiers that are used in some SVG."""
    return set(re.findall(r"url\(#([^)]+)\)", text)) | set(re.findall(r'href="#([^"]+)"', text))


@pytest.mark.parametrize("name", DRAWN)
def test_a_file_stands_alone_and_is_the_same_each_time(files, name):
    root = ElementTree.fromstring(files[name].encode())  # noqa: S314 - our own
    assert root.tag == f"{SVG}svg"
    assert {"width", "height", "viewBox"} <= set(root.attrib)
    identifiers = {element.get("id") for element in root.iter()}
    assert references(files[name]) <= identifiers
    assert "<image" not in files[name]
    assert not re.search(r"\d{4}-\d\d-\d\dT", files[name]), "a date changes from run to run"
    assert svg(sketch(*DRAWN[name])) == files[name]


def test_rounding_moves_no_point_by_more_than_a_hundredth():
    figure = Figure(figsize=(1, 1))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    points = np.array([0.1234567, 0.7654321])
    axes.plot(points, points)
    # The curve is drawn last, upon the paper.
    *_, line = re.findall(r'd="M ([\d.]+) ([\d.]+) *\n?L ([\d.]+) ([\d.]+)', svg(figure))
    # One inch is 72 pt, and the axis of SVG points down.
    expected = [72 * points[0], 72 * (1 - points[0]), 72 * points[1], 72 * (1 - points[1])]
    np.testing.assert_allclose(np.array(line, dtype=float), expected, rtol=0, atol=0.0051)


def test_text_stays_text(files, page):
    for text in (files["outputs"], page):
        root = ElementTree.fromstring(text.encode())  # noqa: S314 - our own
        words = {"".join(element.itertext()).strip() for element in root.iter(f"{SVG}text")}
        assert {"displacement / mm", "measured", "time, test after test / s"} <= words


def test_figures_of_a_page_share_no_identifier_and_references_resolve(page, files):
    identifiers = re.findall(r'\bid="([^"]+)"', page)
    assert len(identifiers) == len(set(identifiers)) > 4
    assert references(page) == set(identifiers), "what is not referred to needs no identifier"
    # Nor do two of the same figure.
    assert not references(inline_svg(files["outputs"], "other", "")) & set(identifiers)


def test_every_colour_of_the_palette_became_one_of_the_page(files, page):
    assert any(shade.light in text for shade in SHADES.values() for text in files.values())
    assert not re.findall("#[0-9a-fA-F]{6}", page)
    used = set(re.findall(r"var\(--([\w-]+)\)", page))
    assert {"ink", "grid", "greybox", "benchmark", "one-step", "faint"} <= used
    assert used <= {name.replace("_", "-") for name in SHADES}


def test_black_of_matplotlib_does_not_stay_on_a_dark_page(page):
    # A shape without a fill or stroke of its own is black; only shapes in definitions may leave it open.
    root = ElementTree.fromstring(page.encode())  # noqa: S314 - our own
    parents = {child: parent for parent in root.iter() for child in parent}

    def styles(element):
        while element is not None:
            yield element.get("style") or ""
            element = parents.get(element)

    inside = {element for definitions in root.iter(f"{SVG}defs") for element in definitions.iter()}
    for kind in ("path", "text", "use"):
        for element in set(root.iter(f"{SVG}{kind}")) - inside:
            style = ";".join(styles(element))
            assert re.search(r"(fill|stroke): *(none|var)", style), ElementTree.tostring(element)


def test_an_element_of_a_page_has_shape_text_no_size(page):
    for tag in ("<style", "<metadata", "<?xml", "<!DOCTYPE", "<script"):
        assert tag not in page
    root = ElementTree.fromstring(page.encode())  # noqa: S314 - our own
    for name, element in zip(DRAWN, root.findall(f"{SVG}svg"), strict=True):
        assert element.get("role") == "img"
        assert element.get("aria-label") == f"what {name} shows"
        assert not {"width", "height"} & set(element.attrib)
        left, top, width, height = map(float, element.get("viewBox").split())
        assert (left, top) == (0, 0)
        # A column of 3.5 inch is 252 pt.
        assert width == pytest.approx(252, abs=0.01)
        assert height > 100


@given(st.text(st.characters(exclude_categories=("Cs", "Cc"))))
def test_whatever_a_text_holds_it_comes_out_as_text(alt):
    small = '<?xml version="1.0"?><svg width="1pt" xmlns="http://www.w3.org/2000/svg"><g id="a"></g></svg>'
    element = inline_svg(small, "name", alt)
    assert ElementTree.fromstring(element.encode()).get("aria-label") == printable(alt)  # noqa: S314 - our own
    assert f'"{escape(printable(alt))}"' in element


@pytest.mark.parametrize("name", ["log-1.23456", "0.0125", "1.005", "\N{MINUS SIGN}0.075"])
def test_numbers_that_are_read_keep_all_their_digits(name):
    figure = Figure()
    figure.text(0.1, 0.1, name)
    assert f">{name}</text>" in svg(figure)


def test_a_name_like_a_colour_or_reference_stays():
    name = f'log {COLOURS["ink"]} url(#a) id="x" <b>'
    figure = Figure()
    figure.text(0.1, 0.1, name)
    root = ElementTree.fromstring(  # noqa: S314 - our own
        f'<div xmlns:xlink="{XLINK[1:-1]}">{inline_svg(svg(figure), "one", "")}</div>'.encode()
    )
    assert name in ["".join(element.itertext()).strip() for element in root.iter("text")]
