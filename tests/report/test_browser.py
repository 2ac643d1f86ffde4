"""A report in a browser, from disk: on a screen and a telephone, in light and in dark, by keyboard."""

from itertools import product

import pytest

import reported
from hitchid.plots.style import SHADES
from hitchid.report import (
    Document,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    figures,
    write_report,
)
from hitchid.report.document import Findings
from legible import contrast
from reported import DRAWN, sketch

pytestmark = pytest.mark.long

WIDTHS, SCHEMES = (1280, 390), ("light", "dark")
TEXT_CONTRAST = 4.5  # what WCAG 2.2 asks of text
LONG_VERDICT = (
    "not determined: K > 988 mm/(s·A) at 95 %; excite above 0.16 Hz, with commands that stand longer"
)
WIDE_TABLE = Table(
    "lifting: parameters of the physics model",
    ("parameter", "unit", "value ± standard error", "95 %", "bootstrap", "RMSE for ±1 % / %", "verdict"),
    tuple(
        (estimate.symbol, estimate.unit, "30.0 ± 1.0", "28.04 … 31.96", "28.5 … 31.4", "0.82", LONG_VERDICT)
        for estimate in reported.ESTIMATES
    ),
)
LONG_NAME = "lifting-" + "0123456789" * 12


def everything():
    """Return a report with each kind of figure and a table too wide for a telephone."""
    narrow = tuple(
        Picture(name, sketch(name, *arguments("mm")), f"Caption of {name}.", f"Text of {name}.")
        for name, arguments in DRAWN.items()
    )
    accuracy = ReportSection("Accuracy", (WIDE_TABLE, Pictures(narrow)))
    timeline = figures.timeline(reported.mixed("cycle-01"))
    wide = Picture("timeline", timeline, "What mixed logs do.", "Displacement over time.", wide=True)
    return Document(
        "Validation of a model",
        "3 unseen lifting tests",
        reported.FINDINGS,
        (f"{LONG_NAME}: a log of a long name.",),
        (
            ReportSection("Lifting", (), (accuracy, ReportSection("Trust", (Text(LONG_NAME),)))),
            ReportSection("Logs", (Findings(reported.FINDINGS), reported.TABLE, Pictures((wide,)))),
        ),
    )


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Return the address of a report on disk."""
    folder = tmp_path_factory.mktemp("browser") / "out"
    write_report(folder, everything(), {"metrics.json": b"{}"}, mark="metrics.json")
    return (folder / "report.html").as_uri()


@pytest.fixture(scope="module")
def opened(browser, address):
    """Return a function that opens the report once for each width and scheme, with what the page said."""
    pages = {}

    def open_page(width, scheme):
        if (width, scheme) not in pages:
            context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
            page = context.new_page()
            messages, requests = [], []
            page.on("console", lambda message: messages.append((message.type, message.text)))
            page.on("pageerror", lambda error: messages.append(("error", str(error))))
            page.on("request", lambda request: requests.append(request.url))
            page.goto(address)
            pages[width, scheme] = page, messages, requests
        return pages[width, scheme]

    return open_page


@pytest.fixture(params=[(1280, "light"), (390, "dark")], ids=str)
def page(opened, request):
    return opened(*request.param)[0]


@pytest.mark.parametrize(("width", "scheme"), list(product(WIDTHS, SCHEMES)))
def test_a_report_is_silent_and_asks_for_nothing_but_itself(opened, address, width, scheme):
    _, messages, requests = opened(width, scheme)
    assert [message for message in messages if message[0] in ("error", "warning")] == []
    assert requests == [address]


def test_sections_are_found_by_their_headings(page):
    for level, name in ((1, "Validation of a model"), (2, "Verdict"), (3, "Accuracy"), (2, "Logs")):
        heading = page.get_by_role("heading", level=level, name=name, exact=True)
        assert heading.count() == 1
        assert heading.is_visible()
    for name in ("Verdict", "Lifting", "Logs"):
        page.get_by_role("link", name=name, exact=True).click()
        assert page.evaluate("location.hash") == f"#{name.lower()}"
    for name in ("outputs", "horizons"):
        assert page.get_by_role("img", name=f"Text of {name}.").count() == 1


@pytest.mark.parametrize(("width", "scheme"), list(product(WIDTHS, SCHEMES)))
def test_a_page_never_runs_over_the_width_of_the_screen(opened, width, scheme):
    page, _, _ = opened(width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    # What is wider than the screen lies in something that scrolls by itself.
    outside = page.evaluate(
        """() => [...document.querySelectorAll('main *, header *, nav *')]
        .filter(each => each.getBoundingClientRect().right > innerWidth + 1)
        .filter(each => !each.closest('.table, .canvas') && !each.closest('.unseen'))
        .map(each => each.outerHTML.slice(0, 80))"""
    )
    assert outside == []


def test_every_figure_is_seen_with_all_its_words(page):
    cut = page.evaluate(
        """() => [...document.querySelectorAll('figure svg')].flatMap(svg => {
            const whole = svg.getBoundingClientRect();
            if (whole.width < 200 || whole.height < 60) return [svg.getAttribute('aria-label')];
            return [...svg.querySelectorAll('text')].filter(text => {
                const box = text.getBoundingClientRect();
                // A browser's DejaVu or its stand-in is a little wider or narrower than matplotlib's.
                return box.left < whole.left - 3 || box.right > whole.right + 3
                    || box.top < whole.top - 3 || box.bottom > whole.bottom + 3;
            }).map(text => svg.getAttribute('aria-label') + ': ' + text.textContent);
        })"""
    )
    assert cut == []


def test_words_of_a_figure_can_be_read_on_a_telephone(opened):
    page, _, _ = opened(390, "dark")
    sizes = page.evaluate(
        """() => [...document.querySelectorAll('figure:not(.wide) svg text')].map(text => {
            const scale = Math.hypot(text.getScreenCTM().a, text.getScreenCTM().b);
            return scale * parseFloat(getComputedStyle(text).fontSize);
        })"""
    )
    assert len(sizes) > 100
    assert min(sizes) >= 8


def test_words_stand_out_from_what_is_behind_them(page):
    drawn = page.evaluate(
        """() => {
            const parts = colour => (colour.match(/[\\d.]+/g) || []).map(Number);
            const behind = element => {
                for (let each = element; each; each = each.parentElement) {
                    const colour = parts(getComputedStyle(each).backgroundColor);
                    if (colour.length == 3 || colour[3] > 0) return colour.slice(0, 3);
                }
                return null;
            };
            const tags = 'h1, h2, h3, p, li, th, td, caption, figcaption, a, .sign';
            const words = [...document.querySelectorAll(tags)]
                .map(each => [each.className, getComputedStyle(each).color, behind(each)]);
            const labels = [...document.querySelectorAll('figure svg text')]
                .map(each => ['svg', getComputedStyle(each).fill, behind(each)]);
            return [...words, ...labels].map(([name, front, back]) => [name, parts(front).slice(0, 3), back]);
        }"""
    )
    assert sum(name == "svg" for name, _, _ in drawn) > 100
    for name, front, back in drawn:
        assert back is not None
        assert contrast(front, back) >= TEXT_CONTRAST, (name, front, back)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_curves_are_drawn_in_the_colours_of_the_scheme(opened, scheme):
    page, _, _ = opened(1280, scheme)
    drawn = page.evaluate(
        """() => [...new Set([...document.querySelectorAll('figure svg path')]
            .map(each => getComputedStyle(each).stroke).filter(each => each.startsWith('rgb(')))]"""
    )

    def parts(colour):
        return f"rgb({', '.join(str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))})"

    shades = {parts(getattr(shade, scheme)) for shade in SHADES.values()}
    assert len(drawn) >= 8
    assert set(drawn) <= shades


def test_levels_of_findings_look_different_and_have_a_sign(page):
    for level in Rating:
        first = page.locator(f"#verdict li.{level.value}").first
        assert first.is_visible()
        assert first.locator(".sign").inner_text().strip() in "✓!✗"
    colours = {
        page.locator(f"#verdict li.{level.value} .sign").first.evaluate(
            "each => getComputedStyle(each).color"
        )
        for level in Rating
    }
    assert len(colours) == len(Rating)


def test_the_keyboard_reaches_links_tables_and_wide_figures_in_order(opened):
    page, _, _ = opened(390, "dark")
    page.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    page.locator("h1").click()
    met = []
    for _ in range(3 + 2 + 1):
        page.keyboard.press("Tab")
        met.append(
            page.evaluate(
                """() => {
                    const each = document.activeElement;
                    const outlined = getComputedStyle(each).outlineStyle != 'none';
                    return [each.getAttribute('aria-label') || each.textContent, outlined];
                }"""
            )
        )
    assert [name for name, _ in met] == [
        "Verdict",
        "Lifting",
        "Logs",
        WIDE_TABLE.title,
        reported.TABLE.title,
        "Displacement over time.",
    ]
    assert all(outlined for _, outlined in met)


def test_a_wide_table_is_scrolled_by_the_keyboard(opened):
    page, _, _ = opened(390, "dark")
    table = page.get_by_role("region", name=WIDE_TABLE.title, exact=True)
    assert table.evaluate("each => each.scrollWidth > each.clientWidth")
    table.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.wait_for_function("() => document.activeElement.scrollLeft > 0", timeout=3000)


def test_a_report_is_printed_on_white_without_a_cut_table(browser, address):
    context = browser.new_context(viewport={"width": 680, "height": 900}, color_scheme="dark")
    page = context.new_page()
    page.goto(address)
    # A sheet of A4 has 180 mm between its margins, 680 px.
    page.emulate_media(media="print", color_scheme="dark")
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert paper in ("rgb(255, 255, 255)", "rgba(0, 0, 0, 0)")
    cut = page.evaluate(
        """() => [...document.querySelectorAll('.table')].filter(each =>
            getComputedStyle(each).overflowX != 'visible' || each.scrollWidth > each.clientWidth + 1
        ).map(each => [each.scrollWidth, each.clientWidth])"""
    )
    assert cut == []
    assert page.pdf(prefer_css_page_size=True).startswith(b"%PDF")
    context.close()
