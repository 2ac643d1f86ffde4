"""HDF5 and NetCDF files: groups, units, scales of time, packed numbers; nothing from outside the file."""

import sys

import h5py
import numpy as np
import pytest
from damaged import assert_same, cut_everywhere, sample, table
from scipy.io import netcdf_file

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.hdf5 import read
from hitchid.logs.formats.library import decode_values

ALL = ChannelSelection("time_s", None)
TIME = np.arange(50) * 20.0


@pytest.fixture
def log(tmp_path):
    """Return a function that hands an open file to whoever fills it and returns the file's path."""

    def save(fill, name="log.h5", **options):
        with h5py.File(tmp_path / name, "w", **options) as file:
            fill(file)
        return tmp_path / name

    return save


def netcdf4(file):
    """Write as NetCDF 4 does: a dimension with its time, packed numbers on it, a dimension without."""
    file.attrs["_NCProperties"] = "version=2,netcdf=4.9.2,hdf5=1.14.3"
    time = file.create_dataset("time", data=TIME)
    time.make_scale("time")
    time.attrs["units"] = np.bytes_("milliseconds since 2024-05-01 10:00:00")
    bare = file.create_dataset("cell", data=np.zeros(3, dtype=">f4"))
    bare.make_scale("This is a netCDF dimension but not a netCDF variable         3")
    packed = file.create_dataset("rig/stroke", data=np.arange(50, dtype=np.int16), dtype=np.int16)
    packed[3] = -999
    packed.attrs["scale_factor"], packed.attrs["add_offset"] = np.float32(0.5), 10.0
    packed.attrs["_FillValue"] = np.array([-999], dtype=np.int16)
    packed.attrs["units"] = "mm"
    packed.dims[0].attach_scale(time)
    plain = file.create_dataset("rig/pressure", data=np.arange(50) / 3)
    plain.attrs["unit"] = np.array([b"bar"])
    plain.dims[0].attach_scale(time)
    loose = file.create_dataset("loose", data=np.arange(3.0))
    loose.dims[0].attach_scale(bare)


@pytest.mark.parametrize("options", [{}, {"libver": "latest"}, {"userblock_size": 512}], ids=str)
@pytest.mark.parametrize("filters", [{}, {"chunks": (16,), "compression": "gzip", "shuffle": True}], ids=str)
def test_doubles_are_read_bit_for_bit(log, options, filters):
    columns = table()

    def fill(file):
        for name, values in columns.items():
            file.create_dataset(f"bench/{name}", data=values, **filters)

    content = read(log(fill, **options), ChannelSelection("time_s", ("stroke_mm", "current_mA", "x")))
    assert list(content.channels) == list(columns)
    assert_same(content, columns)


@pytest.mark.parametrize("turned", [False, True], ids=["rows are samples", "columns are samples"])
@pytest.mark.parametrize("named", [False, True])
def test_columns_of_tables_are_channels(log, turned, named):
    table = np.random.default_rng(0).normal(size=(50, 3))

    def fill(file):
        dataset = file.create_dataset("bench/log", data=table.T if turned else table)
        if named:
            dataset.attrs["columns"], dataset.attrs["units"] = [b"t", b"u", b"x"], [b"s", b"A", b"mm"]

    names = [f"bench/log/{name}" for name in "tux"] if named else [f"bench/log(:,{k})" for k in (1, 2, 3)]
    assert list(read(log(fill), ALL).channels) == names
    for wanted in (names, [f"bench/log(:,{k})" for k in (1, 2, 3)]):
        channels = read(log(fill), ChannelSelection(wanted[0], tuple(wanted[1:]))).channels
        assert [channel.unit for channel in channels.values()] == (["s", "A", "mm"] if named else [None] * 3)
        for name, samples in zip(wanted, table.T, strict=True):
            assert channels[name].values.tobytes() == samples.tobytes()


def test_fields_of_compound_datasets_are_channels(log):
    rows = np.zeros(5, dtype=[("t", "<f8"), ("count", ">i2"), ("note", "S3"), ("pair", "<f8", (2,))])
    rows["t"], rows["count"] = 0.1 * np.arange(5), np.arange(5)
    channels = read(log(lambda file: file.create_dataset("log", data=rows)), ALL).channels
    assert list(channels) == ["log/t", "log/count"]
    np.testing.assert_array_equal(channels["log/t"].values, 0.1 * np.arange(5))
    np.testing.assert_array_equal(channels["log/count"].values, np.arange(5))


def test_every_vector_of_real_numbers_is_listed_by_its_path(log):
    def fill(file):
        file["a"] = np.arange(4, dtype=">i2")
        file["deep/er/b"] = np.arange(4)[:, None]
        file["deep/c"] = np.float16([0.1, 0.2])[None]
        file["flag"] = np.array([True, False])
        file["single"] = file["a"]
        file["soft"] = h5py.SoftLink("/a")
        file["deep/round"] = file["/"]
        file["matrix"] = np.ones((2, 2))
        file["one"], file["scalar"], file["empty"] = np.ones(1), 3.0, h5py.Empty("f8")
        file["complex"], file["text"] = np.ones(3) * 1j, ["a", "b"]
        file["pairs"] = np.zeros(3, dtype=[("x", float)])

    channels = read(log(fill), ALL).channels
    assert sorted(channels) == ["a", "deep/c", "deep/er/b", "flag", "pairs/x", "single"]
    np.testing.assert_array_equal(channels["deep/c"].values, np.float16([0.1, 0.2]))
    np.testing.assert_array_equal(channels["flag"].values, [1.0, 0.0])
    assert all(c.values.ndim == 1 and c.values.dtype == np.float64 for c in channels.values())


def test_scales_of_time_are_clocks_in_seconds(log):
    content = read(log(netcdf4, "log.nc"), ALL)
    assert list(content.channels) == ["loose", "time", "rig/pressure", "rig/stroke"]
    time = content.channels["time"]
    assert time.unit == "s"
    np.testing.assert_array_equal(time.values, np.arange(50) * 20 / 1000)
    assert content.channels["rig/stroke"].clock_s is content.channels["rig/pressure"].clock_s is time.values
    assert content.channels["loose"].clock_s is None
    only = read(log(netcdf4, "log.nc"), ChannelSelection("t", ("stroke",)))
    assert list(only.channels) == ["stroke"]


def test_packed_numbers_are_unpacked_and_filled_ones_are_none(log):
    channels = read(log(netcdf4, "log.nc"), ChannelSelection("time", ("stroke", "pressure"))).channels
    expected = np.arange(50) * 0.5 + 10.0
    expected[3] = np.nan
    np.testing.assert_array_equal(channels["stroke"].values, expected)
    np.testing.assert_array_equal(channels["pressure"].values, np.arange(50) / 3)
    assert (channels["stroke"].unit, channels["pressure"].unit) == ("mm", "bar")


def scaled_by(units):
    """Return what writes a dataset on a scale in these units."""

    def fill(file):
        file["t"], file["x"] = np.arange(5.0), np.arange(5.0)
        if units is not None:
            file["t"].attrs["units"] = units
        file["t"].make_scale()
        file["x"].dims[0].attach_scale(file["t"])

    return fill


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("S", 1.0),
        ("seconds", 1.0),
        ("ms", 1e-3),
        ("Minutes since 2000-01-01", 60.0),
        ("hours", 3600.0),
    ],
)
def test_times_in_other_units_are_converted(log, units, factor):
    clock_s = read(log(scaled_by(units)), ALL).channels["x"].clock_s
    np.testing.assert_allclose(clock_s, np.arange(5) * factor, rtol=1e-15)


@pytest.mark.parametrize("units", ["m", "", None, 3.0])
def test_scales_of_anything_else_are_no_clocks(log, units):
    path = log(scaled_by(units))
    assert read(path, ALL).channels["x"].clock_s is None
    with pytest.raises(LogError, match=r"column 'time_s': .*no such"):
        read(path, ChannelSelection("time_s", ("x",)))


def linked(file):
    file["x"] = h5py.ExternalLink("secret.h5", "/x")


def external(file):
    file.create_dataset("x", (8,), "f8", external=[("secret.bin", 0, 64)])


def virtual(file):
    layout = h5py.VirtualLayout((8,), "f8")
    layout[:] = h5py.VirtualSource("secret.h5", "x", (8,))
    file.create_virtual_dataset("x", layout)


@pytest.mark.parametrize("fill", [linked, external, virtual])
def test_what_is_kept_in_another_file_is_refused(log, tmp_path, fill):
    (tmp_path / "secret.bin").write_bytes(np.arange(8.0).tobytes())
    log(lambda file: file.create_dataset("x", data=np.arange(8.0)), "secret.h5")
    path = log(lambda file: [fill(file), file.create_dataset("y", data=np.arange(8.0))])
    for wanted in (ALL, ChannelSelection("y", ("x",))):
        with pytest.raises(
            LogError, match="column 'x': is a link to another file; expected the data in this file"
        ):
            read(path, wanted)
    np.testing.assert_array_equal(read(path, ChannelSelection("y", ())).channels["y"].values, np.arange(8.0))


@pytest.mark.parametrize("options", [{}, {"libver": "latest"}, {"userblock_size": 512}], ids=str)
def test_no_cut_passes(log, options):
    assert cut_everywhere(log(netcdf4, **options), read) > 110


@pytest.mark.parametrize("name", ["vlen_string_dset.h5", "compound-dtype-complex.h5"])
def test_samples_without_numbers_hold_no_channels(name):
    assert not read(sample("h5py", "tests", "data_files", name), ALL).channels


@pytest.fixture
def classic(tmp_path):
    """Return a function that writes a classic NetCDF file, with time along a fixed or a growing dimension."""

    def save(*, growing=False, version=1):
        with netcdf_file(tmp_path / "log.nc", "w", version=version) as file:
            file.createDimension("time", None if growing else 50)
            file.createDimension("row", 2)
            time = file.createVariable("time", "d", ("time",))
            time[:], time.units = TIME, "ms since 2024-05-01"
            packed = file.createVariable("stroke", "h", ("time",))
            packed[:], packed.units = np.arange(50), "mm"
            packed.scale_factor, packed.add_offset, packed.missing_value = 0.5, 10.0, np.int16(7)
            pressure = file.createVariable("pressure", "d", ("time",))
            pressure[:] = np.arange(50) / 3
            matrix = file.createVariable("matrix", "d", ("time", "row"))
            matrix[:] = np.ones((50, 2))
            file.createVariable("rows", "i", ("row",))[:] = [1, 2]
        return tmp_path / "log.nc"

    return save


@pytest.mark.parametrize("growing", [False, True])
@pytest.mark.parametrize("version", [1, 2])
def test_classic_netcdf_is_read_and_no_cut_of_it_passes(classic, tmp_path, growing, version):
    channels = read(classic(growing=growing, version=version), ALL).channels
    assert sorted(channels) == ["pressure", "rows", "stroke", "time"]
    expected = np.arange(50) * 0.5 + 10.0
    expected[7] = np.nan
    np.testing.assert_array_equal(channels["stroke"].values, expected)
    np.testing.assert_array_equal(channels["pressure"].values, np.arange(50) / 3)
    assert [channels[name].unit for name in sorted(channels)] == [None, None, "mm", "s"]
    np.testing.assert_array_equal(channels["time"].values, np.arange(50) * 20 / 1000)
    assert channels["stroke"].clock_s is channels["pressure"].clock_s is channels["time"].values
    assert channels["rows"].clock_s is None
    assert cut_everywhere(tmp_path / "log.nc", read) > 110


def test_classic_netcdf_needs_no_extra(classic, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "stroke" in read(classic(), ALL).channels


def test_a_classic_netcdf_file_of_others_is_read():
    channels = read(sample("scipy", "io", "tests", "data", "example_3_maskedvals.nc"), ALL).channels
    np.testing.assert_array_equal(np.isnan(channels["var1_fillval0"].values), [False, True, False])


def test_unsigned_numbers_and_valid_ranges_are_as_in_netcdf():
    stored = np.array([-1, 5, 100], dtype=">i2")
    attributes = {"_Unsigned": b"true", "scale_factor": 0.01}
    np.testing.assert_allclose(decode_values(stored, attributes), [655.35, 0.05, 1.0], rtol=1e-15)
    for valid in ({"valid_range": np.array([0, 50])}, {"valid_min": 0, "valid_max": 50}):
        np.testing.assert_array_equal(decode_values(stored, valid), [np.nan, 5.0, np.nan])
