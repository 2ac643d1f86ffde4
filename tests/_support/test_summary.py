"""A summary is at most one screen of text; what does not fit is counted."""

from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.tables import MAX_LINES, MAX_WIDTH, Summary, first_notes, screen, shortened

CELLS = st.text(max_size=200)


@given(
    title=CELLS,
    rows=st.lists(st.tuples(CELLS, CELLS, CELLS), max_size=40),
    notes=st.lists(CELLS, max_size=20),
)
def test_any_summary_fits_on_a_screen(title, rows, notes):
    lines = Summary(title, ("a", "b", "c"), tuple(rows), tuple(notes)).text().splitlines()
    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= MAX_WIDTH


def test_what_does_not_fit_is_counted():
    lines = screen([f"line {number}" for number in range(100)], ["note"]).splitlines()
    assert lines[-2:] == ["  … 77 more lines", "note"]
    assert lines[-3] == "line 22"
    assert first_notes(["a", "b", "c"], 2, "notices") == ("a", "b", "and 1 more: see .notices")
    assert first_notes(["a"], 2, "notices") == ("a",)


def test_a_text_is_shortened_on_one_line():
    assert shortened("a\n  b", 10) == "a b"
    assert shortened("abcdef", 4) == "abc…"


def test_cells_are_escaped_in_html():
    page = Summary("<a>", ("b",), (("<c>",),), ("d & e",)).html()
    assert "<a>" not in page
    assert "<c>" not in page
    assert "d &amp; e" in page
