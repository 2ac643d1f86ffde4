"""Tables of results as data: what is written is read back as it was."""

import csv
import io
from math import isnan

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.inert import printable
from hitchid._support.tables import DataTable, csv_files, stacked
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
def test_every_text_is_read_back_as_it_is_shown_but_for_the_mark_of_what_is_no_formula(texts):
    table = DataTable.of_columns("t", {"log": texts, "value": [1] * len(texts)})
    for (cell, _), text in zip(read(table)[1:], texts, strict=True):
        assert cell in (printable(text), f"'{printable(text)}")
        assert cell == printable(text) or text.lstrip()[0] in "=+-@\uff1d\uff0b\uff0d\uff20"


def test_cells_without_a_value_are_empty_and_decisions_are_words():
    table = DataTable("t", ("a", "b", "c", "d"), ((None, True, False, np.float64(0.1)), (3, "", "x", 0.1)))
    assert read(table)[1:] == [["", "true", "false", "0.1"], ["3", "", "x", "0.1"]]


def test_rows_of_different_keys_share_the_columns_in_their_order_of_appearance():
    table = DataTable.of_rows("t", [{"a": 1}, {"b": 2, "a": 3}])
    assert table.columns == ("a", "b")
    assert table.rows == ((1, None), (3, 2))
    assert len(table) == 2


def test_shorter_columns_end_with_empty_cells():
    table = DataTable.of_columns("t", {"a": (1, 2, 3), "b": np.array([0.5])})
    assert table.rows == ((1, 0.5), (2, None), (3, None))


def test_tables_of_one_name_stand_below_each_other_with_their_origin():
    first = DataTable("t", ("x",), ((1,), (2,)))
    second = DataTable("t", ("x", "y"), ((3, 4),))
    (table,) = stacked({"A": {"t": first}, "B": {"t": second}}, "model").values()
    assert table.columns == ("model", "x", "y")
    assert table.rows == (("A", 1, None), ("A", 2, None), ("B", 3, 4))


def test_a_table_is_a_dataframe_with_the_same_columns_even_without_a_row():
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
