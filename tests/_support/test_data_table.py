"""Tables of results as data, on a screen and as small pictures: nothing is lost unseen."""

import csv
import io
import re
from dataclasses import replace
from math import isnan
from operator import itemgetter
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.inert import printable
from hitchid._support.screen import (
    COLUMNS,
    HEIGHT,
    MARGIN,
    MAX_LINES,
    MAX_WIDTH,
    WIDTH,
    first_notes,
    screen,
    shortened,
    sparkline,
)
from hitchid._support.tables import (
    Column,
    DataTable,
    RecordTable,
    Table,
    csv_files,
    interval_columns,
    number_column,
    stacked,
)
from hitchid.errors import InputError


def read(table):
    return list(csv.reader(io.StringIO(table.csv().decode(), newline="")))


@given(st.lists(st.floats(), min_size=1))
def test_every_number_is_read_back_as_the_same_number(values):
    table = DataTable.of_columns("t", {"x_mm": np.array(values)})
    header, *rows = read(table)
    assert header == ["x_mm"]
    for (cell,), value in zip(rows, values, strict=True):
        assert float(cell) == value or (isnan(float(cell)) and isnan(value))


@given(st.lists(st.text(min_size=1), min_size=1))
def test_a_text_is_read_back_as_shown_or_marked(texts):
    table = DataTable.of_columns("t", {"log": texts, "value": [1] * len(texts)})
    for (cell, _), text in zip(read(table)[1:], texts, strict=True):
        assert cell in (printable(text), f"'{printable(text)}")
        assert cell == printable(text) or text.lstrip()[0] in "=+-@\uff1d\uff0b\uff0d\uff20"


def test_cells_without_a_value_are_empty_and_decisions_are_words():
    table = DataTable("t", ("a", "b", "c", "d"), ((None, True, False, np.float64(0.1)), (3, "", "x", 0.1)))
    assert read(table)[1:] == [["", "true", "false", "0.1"], ["3", "", "x", "0.1"]]


def test_rows_of_different_keys_share_columns():
    table = DataTable.of_rows("t", [{"a": 1}, {"b": 2, "a": 3}])
    assert table.columns == ("a", "b")
    assert table.rows == ((1, None), (3, 2))
    assert len(table) == 2


def test_shorter_columns_end_with_empty_cells():
    table = DataTable.of_columns("t", {"a": (1, 2, 3), "b": np.array([0.5])})
    assert table.rows == ((1, 0.5), (2, None), (3, None))


def test_tables_of_one_name_are_stacked_with_their_origin():
    first = DataTable("t", ("x",), ((1,), (2,)))
    second = DataTable("t", ("x", "y"), ((3, 4),))
    (table,) = stacked({"A": {"t": first}, "B": {"t": second}}, "model").values()
    assert table.columns == ("model", "x", "y")
    assert table.rows == (("A", 1, None), ("A", 2, None), ("B", 3, 4))


def test_a_table_is_a_dataframe_even_without_rows():
    table = DataTable("t", ("log", "rmse_mm", "white"), (("up-1", 0.5, True), ("up-2", None, False)))
    frame = table.to_dataframe()
    assert list(frame.columns) == list(table.columns)
    assert frame["rmse_mm"][0] == 0.5
    assert np.isnan(frame["rmse_mm"][1])
    assert list(DataTable("t", ("a", "b"), ()).to_dataframe().columns) == ["a", "b"]
    pd.testing.assert_frame_equal(pd.read_csv(io.BytesIO(table.csv())), frame)


def test_without_pandas_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(InputError, match=r"pip install 'hitchid\[pandas\]'"):
        DataTable("t", ("a",), ((1,),)).to_dataframe()


def test_each_table_is_a_file_of_its_name():
    table = DataTable("lifting-tests", ("a",), ((1,),))
    assert csv_files([table]) == {"tables/lifting-tests.csv": b"a\n1\n"}
    assert list(csv_files([table], "figures")) == ["figures/lifting-tests.csv"]


def test_a_table_shows_its_name_columns_and_number_of_rows():
    assert repr(DataTable("t", ("a", "b"), ((1, 2),))) == "DataTable('t': 1 rows of a, b)"


def test_one_list_of_columns_is_page_and_file():
    columns = (
        Column("test", "test", itemgetter(0), lambda record: record[0].upper()),
        number_column("rmse_mm", "RMSE / mm", itemgetter(1)),
        *interval_columns("interval_{}_mm", "95 %", itemgetter(2)),
        Column("white", value=lambda record: True),
    )
    records = (("up-1", 1 / 3, (0.1, None)), ("up-2", None, None))
    table = RecordTable("tests", "errors", columns, records[:1], file_records=records[1:])
    assert table.shown() == Table("errors", ("test", "RMSE / mm", "95 %"), (("UP-1", "0.3333", "> 0.1"),))
    assert read(table.data()) == [
        ["test", "rmse_mm", "interval_lower_mm", "interval_upper_mm", "white"],
        ["up-1", repr(1 / 3), "0.1", "", "true"],
        ["up-2", "", "", "", "true"],
    ]
    assert replace(table, records=(), file_records=()).data().columns == ()


# --- summaries: at most one screen -----------------------------------------------------------------------

CELLS = st.text(max_size=200)


@given(
    title=CELLS,
    rows=st.lists(st.tuples(CELLS, CELLS, CELLS), max_size=40),
    notes=st.lists(CELLS, max_size=20),
)
def test_any_summary_fits_on_a_screen(title, rows, notes):
    lines = Table(title, ("a", "b", "c"), tuple(rows), tuple(notes)).text().splitlines()
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
    page = Table("<a>", ("b",), (("<c>",),), ("d & e",)).html()
    assert "<a>" not in page
    assert "<c>" not in page
    assert "d &amp; e" in page


# --- small pictures --------------------------------------------------------------------------------------


def points(picture):
    """Return the points of each curve, shape [N, 2], the strongest last."""
    root = ElementTree.fromstring(picture)  # noqa: S314 - our own
    return [np.array([pair.split(",") for pair in line.get("points").split()], float) for line in root]


@given(samples=st.integers(1, 5000), peak=st.integers(0, 4999))
def test_a_single_peak_is_seen_and_the_picture_stays_small(samples, peak):
    curve = np.zeros(samples)
    curve[peak % samples] = 1.0
    (line,) = points(sparkline([curve], "peak"))
    assert len(line) <= max(2 * COLUMNS, 1)
    if samples > 1:
        assert line[:, 1].min() == MARGIN
        assert line[:, 1].max() == HEIGHT - MARGIN
        assert (
            abs(
                line[line[:, 1].argmin(), 0]
                - MARGIN
                - (WIDTH - 2 * MARGIN) * (peak % samples) / (samples - 1)
            )
            <= 0.5
        )


def test_missing_samples_are_left_out_and_labels_are_escaped():
    curve = np.array([np.nan, 0.0, np.inf, 1.0])
    picture = sparkline([curve, np.full(4, np.nan)], '"><script>')
    assert "<script>" not in picture
    (line,) = points(picture)
    assert len(line) == 2
    assert not re.search("nan|inf", picture)


def test_curves_share_a_scale_where_asked():
    low, high = np.array([0.0, 1.0]), np.array([0.0, 2.0])
    faint, strong = points(sparkline([high, low], "two", [high, high]))
    assert strong[1, 1] == MARGIN
    assert faint[1, 1] == pytest.approx(HEIGHT / 2)
