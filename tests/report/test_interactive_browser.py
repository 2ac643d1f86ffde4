"""The interactive page in a browser: zoom, cursor and read-out by mouse and by keyboard."""

import numpy as np
import pytest

import validated
from hitchid.report import Document, render
from hitchid.report.document import Signals

pytestmark = pytest.mark.long

DIGITS = 1e-5  # of a value shown with six significant digits in single precision: half of the last
DURATION_S = validated.predictions().time_s[0][-1]


def shown():
    """Return tests, the second of which is long enough to be decimated."""
    return validated.predictions((300, 20000))


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Return the address of a page on disk."""
    tests = shown()
    sections = {"lifting": tests, "cycles": tests.take([1])}
    document = Document("Validation", "two tests", signals=Signals(sections, "mm", {"lifting_command": "A"}))
    path = tmp_path_factory.mktemp("interactive") / "interactive.html"
    path.write_bytes(render(document, "interactive"))
    return path.as_uri()


@pytest.fixture
def opened(browser, address):
    """Return a function that opens the page; at the end it has said nothing and asked for nothing else."""
    contexts, messages, requests = [], [], []

    def open_page(width=1280, scheme="light", **options):
        viewport = {"width": width, "height": 800}
        contexts.append(browser.new_context(viewport=viewport, color_scheme=scheme, **options))
        page = contexts[-1].new_page()
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(address)
        # A function: the page forbids that text is evaluated, which is done where it does not hold at once.
        page.wait_for_function("() => document.querySelector('#readout tr') !== null")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert messages == []
    assert set(requests) <= {address}


def settled(page):
    """Wait until the page is drawn anew."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def values(page):
    """Return the read-out: signal to value and error, None where there is none."""
    settled(page)
    rows = page.evaluate(
        """() => [...document.querySelectorAll('#readout tr')].map(row =>
            [row.dataset.signal, ...[...row.querySelectorAll('td')].map(cell => cell.textContent)])"""
    )
    return {name: tuple(float(cell) if cell else None for cell in cells) for name, *cells in rows}


def shown_range(page):
    settled(page)
    return [float(end) for end in page.locator("#range").inner_text().removesuffix(" s").split(" … ")]


def canvas(page, plot="displacement"):
    return page.locator(f"canvas[data-plot='{plot}']")


def sample_at(page, test=0):
    return int(np.argmin(np.abs(shown().time_s[test] - values(page)["time"][0])))


def test_values_at_the_cursor_are_those_of_the_data(opened):
    page, tests = opened(), shown()
    for share in (0.2, 0.55, 0.9):
        box = canvas(page).bounding_box()
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 40)
        read_out, at = values(page), sample_at(page)
        expected = {
            "time": tests.time_s[0][at],
            "command-0": tests.commands["lifting_command"][0][at],
            "measured": tests.actual[0][at],
            "free_run": tests.models["free_run"][0][at],
            "one_step": tests.models["one_step"][0][at],
            "band-lower": tests.band[0][0][at],
            "band-upper": tests.band[1][0][at],
        }
        for name, value in expected.items():
            assert read_out[name][0] == pytest.approx(value, rel=DIGITS), name
        error = tests.actual[0][at] - tests.models["free_run"][0][at]
        # The difference of two numbers near 100 in single precision.
        assert read_out["free_run"][1] == pytest.approx(error, rel=DIGITS, abs=2 * 140 * 2.0**-23)


def test_the_wheel_zooms_around_the_pointer_double_click_resets(opened):
    page = opened()
    assert shown_range(page) == [0.0, pytest.approx(DURATION_S)]
    box = canvas(page).bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 40)
    before = values(page)["time"][0]
    page.mouse.wheel(0, -100)
    page.mouse.wheel(0, -100)
    settled(page)
    start, stop = shown_range(page)
    assert stop - start == pytest.approx(DURATION_S / 1.3**2, abs=0.011)  # two decimals are shown
    assert start < before < stop
    page.mouse.wheel(0, 100)
    assert np.diff(shown_range(page))[0] == pytest.approx(DURATION_S / 1.3, abs=0.011)
    canvas(page, "error").dblclick()
    assert shown_range(page) == [0.0, pytest.approx(DURATION_S)]


def test_a_drag_zooms_every_plot_to_its_range(opened):
    page = opened()
    box = canvas(page, "error").bounding_box()
    axis = box["width"] - 58 - 8  # without the margins of the script
    page.mouse.move(box["x"] + 58 + 0.25 * axis, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 58 + 0.4 * axis, box["y"] + 20)
    page.mouse.move(box["x"] + 58 + 0.5 * axis, box["y"] + 20)
    page.mouse.up()
    start, stop = shown_range(page)
    a_pixel = DURATION_S / axis
    assert start == pytest.approx(0.25 * DURATION_S, abs=0.01 + a_pixel)
    assert stop == pytest.approx(0.5 * DURATION_S, abs=0.01 + a_pixel)


def test_the_keyboard_moves_the_cursor_zooms_and_resets(opened):
    page, time_s = opened(), shown().time_s[0]
    page.locator("#plots").focus()
    at = sample_at(page)
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert values(page)["time"][0] == pytest.approx(time_s[at + 1], rel=DIGITS)
    page.keyboard.press("End")
    assert values(page)["time"][0] == pytest.approx(time_s[-1], rel=DIGITS)
    page.keyboard.press("Home")
    page.keyboard.press("ArrowLeft")
    assert values(page)["time"][0] == 0
    for _ in range(40):
        page.keyboard.press("+")
    start, stop = shown_range(page)
    assert 0 < stop - start < 0.1  # eight samples of 10 ms, rounded
    page.keyboard.press("PageDown")
    assert shown_range(page)[0] > start
    page.keyboard.press("Escape")
    assert shown_range(page) == [0.0, pytest.approx(DURATION_S)]


def test_the_cursor_takes_the_range_with_it(opened):
    page = opened()
    page.locator("#plots").focus()
    page.keyboard.press("Home")
    for _ in range(8):
        page.keyboard.press("+")
    start, stop = shown_range(page)
    page.keyboard.press("End")
    new_start, new_stop = shown_range(page)
    assert new_stop == pytest.approx(DURATION_S, abs=0.01)
    assert new_stop - new_start == pytest.approx(stop - start, abs=0.02)


def test_test_and_direction_are_chosen_and_models_switched(opened):
    page, tests = opened(), shown()
    page.locator("#test").select_option(label="up-02")
    assert shown_range(page)[1] == pytest.approx(tests.time_s[1][-1], abs=0.01)
    assert "lstm" not in values(page)
    page.get_by_label("black-box LSTM").check()
    at = sample_at(page, 1)
    assert values(page)["lstm"][0] == pytest.approx(tests.models["lstm"][1][at], rel=DIGITS)
    page.get_by_label("grey box, free run").uncheck()
    assert not {"free_run", "band-lower"} & set(values(page))
    page.locator("#section").select_option("cycles")
    assert page.locator("#test option").all_inner_texts() == ["up-02"]


def test_a_decimated_curve_reaches_every_extreme(opened):
    """A single sample far off, of 20 000 on 700 pixels, is still drawn: its column reaches the top."""
    page = opened()
    page.locator("#test").select_option(label="up-02")
    settled(page)
    drawn = page.evaluate(
        """() => {
            const values = test.measured.slice();
            values[12345] = 10 * Math.max(...values);
            const scale = { x: (t) => 58 + t * 3, y: (v) => v, right: 658 };
            return [values[12345], Math.max(...points(values, 0, values.length - 1, scale).map(p => p[1])),
                points(values, 0, values.length - 1, scale).length];
        }"""
    )
    assert drawn[0] == drawn[1]
    assert drawn[2] <= 2 * (200 * 3 + 1)  # two points in each column of 200 s at 3 px/s


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 768, 1280])
def test_nothing_overflows_the_screen_and_every_plot_is_drawn(opened, width, scheme):
    page = opened(width, scheme)
    settled(page)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for plot in ("displacement", "error", "command"):
        inked = canvas(page, plot).evaluate(
            """each => each.getContext('2d').getImageData(0, 0, each.width, each.height).data
                .filter((part, i) => i % 4 === 3 && part > 0).length"""
        )
        assert inked > 500


def test_a_touch_moves_the_cursor_and_buttons_zoom(opened):
    page = opened(390, has_touch=True, is_mobile=True)
    before = values(page)["time"][0]
    box = canvas(page).bounding_box()
    page.touchscreen.tap(box["x"] + 0.8 * box["width"], box["y"] + 50)
    assert values(page)["time"][0] > before
    page.get_by_role("button", name="Zoom in").tap()
    assert np.diff(shown_range(page))[0] < DURATION_S
    page.get_by_role("button", name="Reset").tap()
    assert shown_range(page) == [0.0, pytest.approx(DURATION_S)]
