"""MATLAB files: vectors of any kind of number, and everything else refused."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import sparse
from scipy.io import savemat

from hitchid.errors import LogError
from hitchid.readers.mat import column_names, read_rows, read_table

SAMPLES = 50
SIGNALS = {"t": np.arange(SAMPLES) / 100, "up": np.arange(SAMPLES) % 3, "x": np.sqrt(np.arange(SAMPLES))}
NAMES = tuple(SIGNALS)
WAYS = ({}, {"oned_as": "column"}, {"do_compression": True}, {"format": "4"})
finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture
def log(tmp_path):
    """Return a function that saves vectors beside the plain signals and returns the file's path."""

    def save(beside=None, **options):
        savemat(tmp_path / "log.mat", {**SIGNALS, **(beside or {})}, **options)
        return tmp_path / "log.mat"

    return save


@pytest.mark.parametrize("way", WAYS, ids=["rows", "columns", "compressed", "version 4"])
def test_vectors_are_read_however_they_were_saved(log, way):
    path = log(**way)
    table = read_table(path, ["x", "t"])
    assert list(table.columns) == ["x", "t"]
    assert (table.source, table.line_of(0)) == (path, None)
    for name in ("x", "t"):
        np.testing.assert_array_equal(table.columns[name], SIGNALS[name])


@settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(samples=arrays(np.float64, st.integers(2, 30), elements=finite))
def test_any_finite_number_reads_back_bit_for_bit(tmp_path, samples):
    savemat(tmp_path / "log.mat", {"x": samples})
    assert read_table(tmp_path / "log.mat", ["x"]).columns["x"].tobytes() == samples.tobytes()


@pytest.mark.parametrize("kind", [np.int8, np.uint16, np.int32, np.int64, np.float32, np.bool_])
def test_whole_single_and_logical_numbers_are_numbers(log, kind):
    samples = (np.arange(SAMPLES) % 2).astype(kind)
    read = read_table(log({"x": samples}), ["x"]).columns["x"]
    assert read.dtype == np.float64
    np.testing.assert_array_equal(read, samples)


NO_VECTORS = {
    "a matrix": np.ones((2, SAMPLES)),
    "one number": 3.0,
    "nothing": np.zeros(0),
    "text": "x" * SAMPLES,
    "a struct": {"a": 1},
}
NO_NUMBERS = {
    "complex": np.ones(SAMPLES) * 1j,
    "cells": np.array([["x"] * SAMPLES], dtype=object),
    "structs": np.zeros((1, SAMPLES), dtype=[("a", float)]),
}


@pytest.mark.parametrize("x", NO_VECTORS.values(), ids=NO_VECTORS.keys())
def test_what_is_no_vector_is_missed_by_name_beside_those_there_are(log, x):
    with pytest.raises(LogError, match=r"log\.mat: column 'x': there is no such vector.*found t, up$"):
        read_table(log({"x": x}), NAMES)


@pytest.mark.parametrize("x", NO_NUMBERS.values(), ids=NO_NUMBERS.keys())
def test_what_holds_no_real_numbers_is_refused_by_name(log, x):
    with pytest.raises(LogError, match=r"log\.mat: column 'x': required a real numeric vector"):
        read_table(log({"x": x}), NAMES)


def test_a_sparse_vector_is_read_or_refused(log):
    dense = np.zeros(SAMPLES)
    dense[7] = 2.5
    try:
        read = read_table(log({"x": sparse.csc_matrix(dense[None])}), NAMES).columns["x"]
    except LogError as error:
        assert "'x'" in str(error)  # noqa: PT017
        return
    np.testing.assert_array_equal(read, dense)


def test_vectors_of_unlike_length_are_refused_with_both_lengths(log):
    with pytest.raises(LogError, match=r"column 'x': has 49 samples, required 50 as 't'"):
        read_table(log({"x": np.ones(SAMPLES - 1)}), NAMES)


def test_names_are_those_of_the_vectors(log):
    beside = {**{f"v{n}": value for n, value in enumerate(NO_VECTORS.values())}, "short": np.ones(3)}
    assert sorted(column_names(log(beside))) == ["short", "t", "up", "x"]


def test_rows_hold_every_vector_of_numbers_as_long_as_time(log):
    beside = {"short": np.ones(3), "note": "x" * SAMPLES, "spare": np.full(SAMPLES, np.nan)}
    header, rows = read_rows(log(beside), "t")
    assert header == [*NAMES, "spare"]
    np.testing.assert_array_equal(np.array(rows, dtype=float)[:, :3].T, list(SIGNALS.values()))


@pytest.mark.parametrize("beside", NO_NUMBERS.values(), ids=NO_NUMBERS.keys())
def test_rows_leave_out_what_holds_no_numbers(log, beside):
    header, rows = read_rows(log({"beside": beside}), "t")
    assert header == list(NAMES)
    assert len(rows) == SAMPLES


@pytest.mark.parametrize("way", WAYS, ids=["rows", "columns", "compressed", "version 4"])
def test_a_file_cut_short_anywhere_is_refused(log, way):
    path = log(**way)
    whole = path.read_bytes()
    for size in range(0, len(whole), 11):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"log\.mat"):
            read_table(path, NAMES)


def test_a_damaged_compressed_file_is_refused(log):
    # Compressed parts carry a checksum: damage in them cannot pass for data.
    path = log(do_compression=True)
    whole = path.read_bytes()
    for at in range(144, len(whole), 13):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        with pytest.raises(LogError, match=r"log\.mat"):
            read_table(path, NAMES)


FOREIGN = {
    "empty": b"",
    "one byte": b"x",
    "csv": b"time_s,x\n0,1\n" * 100,
    "noise": bytes(range(256)) * 8,
    "nuls": b"\x00" * 400,
    "version 7.3": b"\x89HDF\r\n\x1a\n" + b"\x00" * 600,
}


@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN.keys())
def test_what_is_no_matlab_file_up_to_version_7_is_refused(tmp_path, content):
    path = tmp_path / "log.mat"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        read_table(path, NAMES)
    assert str(caught.value).startswith(f"{path}: ")


def test_what_is_no_file_is_refused(tmp_path):
    (tmp_path / "folder.mat").mkdir()
    for name in ("folder.mat", "missing.mat"):
        with pytest.raises(LogError, match="cannot be read"):
            read_table(tmp_path / name, NAMES)
