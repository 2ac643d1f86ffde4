"""Metadata of machines: texts and numbers by machine, and files that cannot be used."""

import csv

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.fleet import read_metadata

TABLE = "machine, oil ,age_h\na,HV46,100\nb,,\nc,HV32,1e3\n"


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a file and returns its path."""

    def write(text):
        path = tmp_path / "machines.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_column_is_of_numbers_or_texts_whatever_surrounds_it(written):
    metadata = read_metadata(written(TABLE))
    assert metadata.columns == {"oil": ("HV46", None, "HV32"), "age_h": (100.0, None, 1000.0)}
    assert metadata.of(["c", "x", "a"]) == {"oil": ("HV32", None, "HV46"), "age_h": (1000.0, None, 100.0)}
    assert read_metadata(f"file://{metadata.source}").columns == metadata.columns  # as a store is read
    # A byte order mark and empty lines are no content.
    assert read_metadata(written("\ufeff" + TABLE.replace("\n", "\n\n"))) == metadata


def test_who_is_missing_on_either_side_is_told(written):
    metadata = read_metadata(written(TABLE))
    absent, unknown = metadata.notices(["a", "b", "x", "failed"], ["a", "x"])
    assert "no line for x; not" in absent
    assert "no result for c; left out" in unknown
    assert metadata.notices("abc", "abc") == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got nothing, expected 'machine'"),
        ("name,oil\na,b\n", "got name, oil, expected 'machine'"),
        ("machine,oil,oil\na,b,c\n", "expected 'machine' and others, each once"),
        ("machine\na\n", "got the column 'machine' alone"),
        ("machine,oil\na,b\na,c\n", "got a twice"),
        ("machine,oil\na,b,c\n", "line 1 below the header: got 3 cells, expected 2"),
        ('machine,oil\na,"b\n', "is not a CSV file"),
        ("machine,oil\n\udcff\udcfe,b\n", "is not a CSV file in UTF-8"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path, text, message):
    path = tmp_path / "machines.csv"
    with pytest.raises(InputError, match=r"machines\.csv: does not exist"):
        read_metadata(path)
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match=message):
        read_metadata(path)


CELLS = st.text(
    st.characters(categories=["L", "N", "P"], exclude_characters="\ufeff"), min_size=1, max_size=8
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.dictionaries(CELLS, CELLS, min_size=1, max_size=5))
def test_every_text_that_a_csv_writer_writes_is_read_back(tmp_path, rows):
    path = tmp_path / "machines.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("machine", "oil"), *rows.items(), ("last", "not a number")])
    read = read_metadata(path)
    expected = {**rows, "last": "not a number"}
    if "last" not in rows:
        assert dict(zip(read.machines, read.columns["oil"], strict=True)) == expected
