"""MATLAB files of every version: vectors of any numbers, structs, exports of ControlDesk and Simulink."""

import struct
import zlib

import h5py
import numpy as np
import pytest
from damaged import cut_everywhere, sample
from mat_files import mat73
from scipy import sparse
from scipy.io import savemat

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.mat import read

SAMPLES = 50
SIGNALS = {"t": np.arange(SAMPLES) / 100, "up": np.arange(SAMPLES) % 3, "x": np.sqrt(np.arange(SAMPLES))}
ALL, SOME = ChannelSelection("t", None), ChannelSelection("t", ("x", "up"))
WAYS = ({}, {"oned_as": "column"}, {"do_compression": True}, {"format": "4"})
WAY_NAMES = ["rows", "columns", "compressed", "version 4"]


@pytest.fixture
def log(tmp_path):
    """Return a function that saves vectors beside the plain signals and returns the file's path."""

    def save(beside=None, **options):
        savemat(tmp_path / "log.mat", {**SIGNALS, **(beside or {})}, **options)
        return tmp_path / "log.mat"

    return save


@pytest.mark.parametrize("way", WAYS, ids=WAY_NAMES)
def test_vectors_are_read_however_they_were_saved(log, way):
    path = log(**way)
    content = read(path, ChannelSelection("t", ("x",)))
    assert list(content.channels) == ["t", "x"]
    assert (content.source, content.line_of(0)) == (path, None)
    for name, channel in content.channels.items():
        np.testing.assert_array_equal(channel.values, SIGNALS[name])
        assert (channel.unit, channel.clock_s) == (None, None)


@pytest.mark.parametrize("kind", [np.int8, np.uint16, np.int32, np.int64, np.float32, np.bool_])
def test_whole_single_and_logical_numbers_are_numbers(saved, kind):
    samples = (np.arange(SAMPLES) % 2).astype(kind)
    values = read(saved({"x": samples}), ALL).channels["x"].values
    assert (values.dtype, values.shape) == (np.float64, (SAMPLES,))
    np.testing.assert_array_equal(values, samples)


@pytest.mark.parametrize("turned", [False, True], ids=["rows are samples", "columns are samples"])
def test_columns_of_matrices_are_channels(saved, turned):
    data = np.random.default_rng(0).normal(size=(SAMPLES, 3))
    names = [f"data(:,{k})" for k in (1, 2, 3)]
    path = saved({"data": data.T if turned else data})
    assert list(read(path, ALL).channels) == names
    channels = read(path, ChannelSelection(names[0], tuple(names[1:]))).channels
    for name, samples in zip(names, data.T, strict=True):
        np.testing.assert_array_equal(channels[name].values, samples)


NO_VECTORS = {
    "complex numbers": np.ones(SAMPLES) * 1j,
    "a square": np.ones((3, 3)),
    "a cube": np.ones((2, 2, SAMPLES)),
    "one number": 3.0,
    "nothing": np.zeros(0),
    "text": "x" * SAMPLES,
    "a struct": {"a": 1},
    "cells": np.array([["x"] * SAMPLES], dtype=object),
    "structs": np.zeros((1, SAMPLES), dtype=[("a", float)]),
    "sparse": sparse.csc_matrix(np.arange(SAMPLES)[None] * 1.0),
}


@pytest.mark.parametrize("x", NO_VECTORS.values(), ids=NO_VECTORS.keys())
def test_what_is_no_vector_is_missed_by_name(log, x):
    message = "vector" if np.iscomplexobj(x) else "found t, up$"
    with pytest.raises(LogError, match=rf"log\.mat: column 'x': .*{message}"):
        read(log({"x": x}), SOME)
    assert list(read(log({"x": x}), ALL).channels) == ["t", "up"]


MIXED = ChannelSelection("x", ("log/rig/x", "stroke"))
NESTED = {
    "log": {"t": SIGNALS["t"], "rig": {"x": SIGNALS["x"], "one": 2.0}, "note": "cold"},
    "x": SIGNALS["x"] / 3,
}


def test_fields_of_structs_are_named_by_their_path(saved):
    path = saved(NESTED)
    content = read(path, ALL)
    assert sorted(content.channels) == ["log/rig/x", "log/t", "x"]
    np.testing.assert_array_equal(content.channels["log/rig/x"].values, SIGNALS["x"])
    np.testing.assert_array_equal(
        read(path, ChannelSelection("log/t", ("x",))).channels["x"].values, SIGNALS["x"] / 3
    )
    with pytest.raises(LogError, match=r"'t': .*'x'.*'log/t'"):
        read(path, ChannelSelection("t", ("x",)))
    assert list(read(path, ChannelSelection("t", ("log/rig/x",))).channels) == ["t", "log/rig/x"]


def control_desk(**more):
    fast, slow = {"Name": "", "Data": SIGNALS["t"]}, {"Name": "", "Data": np.arange(5.0)}
    ours = [
        {"Name": "Model Root/stroke", "Data": SIGNALS["x"], "Unit": "mm", "XIndex": 1.0},
        {"Name": "Model Root/pressure", "Data": np.arange(5.0) ** 2, "Unit": "", "XIndex": 2.0},
        {"Name": "flow", "Data": SIGNALS["x"] / 3, "Unit": "l/min", "XIndex": 1.0},
    ]
    return {"X": [fast, slow], "Y": ours, "Description": {"DateTime": "2024-05-01"}, "RTProgram": {}, **more}


def test_signals_of_control_desk_bring_their_clock(saved):
    path = saved({"rec_001": control_desk(RTProgram="x")})
    channels = read(path, ALL).channels
    assert list(channels) == ["Model Root/stroke", "Model Root/pressure", "flow"]
    assert [channel.unit for channel in channels.values()] == ["mm", None, "l/min"]
    np.testing.assert_array_equal(channels["Model Root/stroke"].clock_s, SIGNALS["t"])
    np.testing.assert_array_equal(channels["Model Root/pressure"].clock_s, np.arange(5.0))
    assert channels["flow"].clock_s is channels["Model Root/stroke"].clock_s
    np.testing.assert_array_equal(channels["flow"].values, SIGNALS["x"] / 3)
    assert list(read(path, ChannelSelection("time_s", ("stroke",))).channels) == ["stroke"]


def test_a_control_desk_export_on_one_axis_needs_no_index(saved):
    axis, signal = {"Data": SIGNALS["t"] * 1000, "Unit": "ms"}, {"Name": "a", "Data": SIGNALS["x"]}
    short = {"Name": "b", "Data": np.arange(4.0)}
    channels = read(saved({"rec": {"X": axis, "Y": [signal, short]}}), ALL).channels
    np.testing.assert_allclose(channels["a"].clock_s, SIGNALS["t"], rtol=1e-15)
    assert channels["b"].clock_s is None


def test_two_exports_in_one_file_are_told_apart(saved):
    one = {"X": {"Data": SIGNALS["t"]}, "Y": {"Name": "a", "Data": SIGNALS["x"]}}
    assert sorted(read(saved({"first": one, "second": one}), ALL).channels) == ["first/a", "second/a"]


@pytest.mark.parametrize("count", [1, 2])
def test_structures_with_time_of_simulink_bring_their_clock(saved, count):
    named = {"values": SIGNALS["x"][:, None], "label": "stroke", "dimensions": 1.0}
    nameless = {"values": SIGNALS["up"][:, None] * 1.0, "label": "", "dimensions": 1.0}
    signals = [named, nameless] if count == 2 else named
    channels = read(saved({"out": {"time": SIGNALS["t"], "signals": signals}}), ALL).channels
    assert list(channels) == ["out/time", "out/stroke", "out/signals(2)"][: count + 1]
    assert (channels["out/time"].unit, channels["out/stroke"].unit) == ("s", None)
    np.testing.assert_array_equal(channels["out/stroke"].values, SIGNALS["x"])
    for channel in channels.values():
        np.testing.assert_array_equal(channel.clock_s, SIGNALS["t"])
        assert channel.clock_s is channels["out/time"].clock_s


def test_signals_of_a_muxed_scope_bring_the_clock_of_all(saved):
    time, values = 0.01 * np.arange(SAMPLES), np.random.default_rng(0).normal(size=(SAMPLES, 2))
    path = saved({"scope": {"time": time, "signals": {"values": values, "label": "mux"}}})
    channels = read(path, ChannelSelection("time_s", ("scope/mux(:,1)", "scope/mux(:,2)"))).channels
    for name, samples in zip(("scope/mux(:,1)", "scope/mux(:,2)"), values.T, strict=True):
        np.testing.assert_array_equal(channels[name].values, samples)
        np.testing.assert_array_equal(channels[name].clock_s, time)


def test_what_is_kept_in_another_file_is_refused(tmp_path):
    mat73(tmp_path / "secret.mat", {"x": SIGNALS["x"]})
    mat73(tmp_path / "log.mat", {"t": SIGNALS["t"]})
    with h5py.File(tmp_path / "log.mat", "r+") as file:
        file["x"] = h5py.ExternalLink("secret.mat", "/x")
    with pytest.raises(
        LogError, match="column 'x': is a link to another file; expected the data in this file"
    ):
        read(tmp_path / "log.mat", ChannelSelection("t", ("x",)))


@pytest.mark.parametrize("way", WAYS, ids=WAY_NAMES)
def test_a_file_cut_short_anywhere_is_refused(log, way):
    path = log(**way)
    whole = path.read_bytes()
    for size in range(0, len(whole), 31):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"log\.mat"):
            read(path, SOME)


def test_no_cut_of_structs_passes(saved):
    assert cut_everywhere(saved(NESTED | {"rec": control_desk(RTProgram="x")}), read, MIXED, cuts=200) >= 200


def test_a_cut_names_where_it_is(log):
    path = log()
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(LogError, match=r"truncated: .*byte \d+.* \d+$"):
        read(path, SOME)


def test_a_damaged_compressed_file_is_refused(log):
    # Compressed parts carry a checksum: damage in them cannot pass for data.
    path = log(do_compression=True)
    whole = path.read_bytes()
    for at in range(144, len(whole), 13):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        with pytest.raises(LogError, match=r"log\.mat"):
            read(path, SOME)


def matrix(kind, shape, length=None):
    """Return a variable of MATLAB 5 that declares a shape and carries one number."""
    inside = struct.pack("<IIII", 6, 8, kind, 0) + struct.pack("<II", 5, 4 * len(shape))
    inside += (
        struct.pack(f"<{len(shape)}I", *shape)
        + struct.pack("<II8s", 1, 1, b"x")
        + struct.pack("<IId", 9, 8, 1.0)
    )
    return struct.pack("<II", 14, len(inside) if length is None else length) + inside


HUGE = (0x40000000, 0x40000000)


def packed(variable):
    squeezed = zlib.compress(variable)
    return struct.pack("<II", 15, len(squeezed)) + squeezed


@pytest.mark.parametrize(
    ("variable", "declared"),
    [
        (matrix(1, HUGE), "1152921504606846976 values"),
        (matrix(2, HUGE), "1152921504606846976 values"),
        (matrix(6, HUGE), "1152921504606846976 values"),
        (packed(matrix(6, HUGE)), "1152921504606846976 values"),
        (packed(matrix(6, (1, 2), length=0xFFFFFFF0)), "4294967280"),
    ],
    ids=["cells", "structs", "doubles", "compressed doubles", "a compressed part"],
)
def test_absurd_sizes_are_refused_before_memory_is_required(tmp_path, variable, declared):
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")
    (tmp_path / "log.mat").write_bytes(header + variable)
    with pytest.raises(LogError, match=rf"\d+ bytes declare {declared}"):
        read(tmp_path / "log.mat", ALL)


REAL = {
    "testdouble_4.2c_SOL2": ["testdouble"],
    "testdouble_6.1_SOL2": ["testdouble"],
    "testdouble_7.4_GLNX86": ["testdouble"],
    "testmulti_7.4_GLNX86": ["a(:,1)", "a(:,2)", "a(:,3)", "theta"],
    "teststruct_7.4_GLNX86": ["teststruct/doublefield"],
    "testvec_4_GLNX86": ["fit_params", "xdot_filt"],
    "testbool_8_WIN64": ["testbools"],
    "testcell_7.4_GLNX86": ["testcell{3}", "testcell{4}"],
    "testcomplex_7.4_GLNX86": [],
    "testobject_7.4_GLNX86": [],
    "teststructnest_7.4_GLNX86": [],
    "teststring_7.4_GLNX86": [],
    "testsparse_7.4_GLNX86": [],
}


@pytest.mark.parametrize(("name", "channels"), REAL.items())
def test_files_of_matlab_are_read(name, channels):
    path = sample("scipy", "io", "matlab", "tests", "data", f"{name}.mat")
    content = read(path, ALL)
    assert list(content.channels) == channels
    if name.startswith("testdouble"):
        np.testing.assert_allclose(
            content.channels["testdouble"].values, np.arange(9) * np.pi / 4, rtol=1e-12
        )
