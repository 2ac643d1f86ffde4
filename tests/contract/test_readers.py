"""One protocol over every log format."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import savemat

from hitchid.errors import LogError
from hitchid.readers import find_logs, write_table
from hitchid.readers.reading import FORMATS, format_of, record_name

NAMES = ("time_s", "current_up_A", "displacement_mm")
SIGNALS = {
    "time_s": np.arange(40) / 100,
    "current_up_A": np.arange(40) % 2 * 0.5,
    "displacement_mm": np.sqrt(np.arange(40.0)),
}
# How a log of each ending is made; a new format adds its line here.
WRITERS = {".csv": write_table, ".csv.gz": write_table, ".mat": savemat}

every_ending = pytest.mark.parametrize("ending", [suffix for known in FORMATS for suffix in known.suffixes])
finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def log(tmp_path):
    """Return a function that writes signals as a log with an ending and returns format and path."""

    def write(ending, signals=SIGNALS, name="log"):
        path = tmp_path / f"{name}{ending}"
        WRITERS[ending](path, dict(signals))
        return format_of(path), path

    return write


@every_ending
@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(numbers=arrays(np.float64, st.tuples(st.integers(2, 20), st.just(3)), elements=finite))
def test_the_same_signals_come_out_bit_for_bit(log, ending, numbers):
    known, path = log(ending, dict(zip(NAMES, numbers.T, strict=True)))
    table = known.read_table(path, NAMES)
    assert table.source == path
    assert list(table.columns) == list(NAMES)
    for column, samples in zip(NAMES, numbers.T, strict=True):
        assert table.columns[column].dtype == np.float64
        assert table.columns[column].tobytes() == samples.tobytes()


@every_ending
def test_columns_come_in_the_order_asked_for_and_no_others(log, ending):
    known, path = log(ending)
    table = known.read_table(path, ["displacement_mm", "time_s"])
    assert list(table.columns) == ["displacement_mm", "time_s"]


@every_ending
def test_a_missing_column_is_named_beside_those_there_are(log, ending):
    known, path = log(ending)
    with pytest.raises(LogError) as caught:
        known.read_table(path, ["time_s", "current_down_A"])
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "'current_down_A'" in message
    assert all(name in message for name in NAMES)


@every_ending
def test_a_file_cut_short_anywhere_gives_a_log_error_and_nothing_else(log, ending):
    known, path = log(ending)
    whole = path.read_bytes()
    refused = 0
    for size in range(0, len(whole), max(1, len(whole) // 150)):
        path.write_bytes(whole[:size])
        try:
            table = known.read_table(path, NAMES)
        except LogError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017
            refused += 1
        else:
            # Plain text cut at the end of a line, or within its last number, is a shorter log.
            assert ending == ".csv"
            (rows,) = {table.columns[name].size for name in NAMES}
            np.testing.assert_array_equal(table.columns["time_s"], SIGNALS["time_s"][:rows])
    assert refused > 0


@every_ending
@pytest.mark.parametrize("content", [b"", b"\x00", b"\xff" * 200, b"\n", bytes(range(256))])
def test_what_is_no_log_of_the_format_gives_a_log_error_and_nothing_else(log, ending, content):
    known, path = log(ending)
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        known.read_table(path, NAMES)
    assert str(caught.value).startswith(f"{path}: ")


@every_ending
def test_a_folder_or_a_missing_file_gives_a_log_error_and_nothing_else(tmp_path, ending):
    (tmp_path / f"folder{ending}").mkdir()
    for name in ("folder", "missing"):
        path = tmp_path / f"{name}{ending}"
        with pytest.raises(LogError, match="cannot be read"):
            format_of(path).read_table(path, NAMES)


@every_ending
def test_rows_are_the_same_numbers_as_text(log, ending):
    known, path = log(ending)
    header, rows = known.read_rows(path, "time_s")
    assert header == list(NAMES)
    np.testing.assert_array_equal(np.array(rows, dtype=float).T, list(SIGNALS.values()))


@every_ending
def test_a_log_is_found_in_its_folder_and_named_without_its_ending(log, tmp_path, ending):
    _, path = log(ending, name="step 0.5 A [1]")
    assert find_logs(tmp_path) == [path]
    assert record_name(path) == "step 0.5 A [1]"


@every_ending
def test_the_case_of_an_ending_does_not_matter(log, tmp_path, ending):
    known, path = log(ending)
    shouted = path.rename(tmp_path / f"log{ending.upper()}")
    assert format_of(shouted) is known
    table = known.read_table(shouted, NAMES)
    np.testing.assert_array_equal(table.columns["time_s"], SIGNALS["time_s"])
