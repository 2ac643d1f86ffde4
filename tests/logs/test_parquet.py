"""Parquet files: exact round trips, what pandas and others write, damage found by checksums."""

import decimal

import numpy as np
import pyarrow as pa
import pytest
from damaged import assert_same, cut_everywhere, sample, table
from pyarrow import parquet

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.parquet import read, write_table

ALL = ChannelSelection("time_s", None)


@pytest.fixture
def log(tmp_path):
    """Return a function that writes columns, of any kind, and returns the file's path."""

    def save(columns, metadata=None, **options):
        arrays = {name: pa.array(values) for name, values in columns.items()}
        units = metadata or {}
        fields = [pa.field(name, values.type, metadata=units.get(name)) for name, values in arrays.items()]
        rows = pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))
        parquet.write_table(rows, tmp_path / "log.parquet", **options)
        return tmp_path / "log.parquet"

    return save


def test_a_written_table_reads_back_bit_for_bit(tmp_path):
    columns = table()
    write_table(tmp_path / "log.parquet", columns)
    content = read(tmp_path / "log.parquet", ChannelSelection("time_s", ("stroke_mm", "current_mA", "x")))
    assert list(content.channels) == list(columns)
    assert_same(content, columns)
    assert [channel.unit for channel in content.channels.values()] == ["s", "mm", "mA", None]
    assert all(channel.clock_s is None for channel in content.channels.values())


def test_only_the_wanted_columns_are_read(log):
    path = log({"t": [0.0, 1.0], "a": [1.0, 2.0], "a.b": [3.0, 4.0], "spare": [5.0, 6.0]})
    content = read(path, ChannelSelection("t", ("a.b",)))
    assert list(content.channels) == ["t", "a.b"]
    np.testing.assert_array_equal(content.channels["a.b"].values, [3.0, 4.0])
    with pytest.raises(
        LogError,
        match=r"column 'b': there is no such channel; .*; found t, a, a\.b",
    ):
        read(path, ChannelSelection("t", ("b",)))


def test_every_kind_of_number_is_read_and_nothing_else(log):
    kinds = {
        "whole": [1, 2, None],
        "small": np.array([1, 2, 3], dtype=np.uint8),
        "large": np.array([2**62, 1, -(2**62)]),
        "single": np.array([0.1, 0.2, 0.3], dtype=np.float32),
        "flag": [True, None, False],
        "repeated": pa.array([1.5, None, 1.5]).dictionary_encode(),
        "price": [decimal.Decimal("1.25"), decimal.Decimal("2.50"), None],
        "text": ["a", "b", "c"],
        "pairs": [[1.0], [2.0], [3.0]],
        "struct": [{"x": 1.0}] * 3,
    }
    channels = read(log(kinds), ALL).channels
    assert list(channels) == ["whole", "small", "large", "single", "flag", "repeated", "price"]
    np.testing.assert_array_equal(channels["repeated"].values, [1.5, np.nan, 1.5])
    np.testing.assert_array_equal(channels["whole"].values, [1, 2, np.nan])
    np.testing.assert_array_equal(channels["large"].values, [2.0**62, 1, -(2.0**62)])
    np.testing.assert_array_equal(channels["single"].values, np.float32([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(channels["flag"].values, [1, np.nan, 0])
    np.testing.assert_array_equal(channels["price"].values, [1.25, 2.5, np.nan])
    assert all(channel.values.dtype == np.float64 for channel in channels.values())
    assert not read(log({"one row": [1.0]}), ALL).channels


@pytest.mark.parametrize("tick", ["s", "ns"])
def test_time_stamps_turn_into_seconds_since_the_first(log, tick):
    start = np.datetime64("2024-05-01T10:00:00", tick)
    stamps = start + np.array([0, 1, 2, 30]) * np.timedelta64(1, tick)
    time = read(log({"t": stamps, "x": np.arange(4.0)}), ChannelSelection("t", ("x",))).channels["t"]
    step = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[tick]
    assert time.unit == "s"
    np.testing.assert_array_equal(time.values, np.array([0, 1, 2, 30]) / step)


def test_missing_stamps_are_nan_and_durations_keep_their_start(log):
    stamps = pa.array([None, 1_000, 2_500], pa.timestamp("ms", tz="UTC"))
    channels = read(log({"t": stamps, "d": pa.array([5, 10, None], pa.duration("ms"))}), ALL).channels
    np.testing.assert_array_equal(channels["t"].values, [np.nan, 0.0, 1.5])
    np.testing.assert_array_equal(channels["d"].values, [0.005, 0.01, np.nan])


def test_units_stand_in_the_metadata_of_the_fields(log):
    columns = {name: [1.0, 2.0] for name in "abcd"}
    units = {"a": {"unit": "mm"}, "b": {"units": " bar "}, "c": {"unit": " ", "note": "x"}}
    assert [c.unit for c in read(log(columns, units), ALL).channels.values()] == ["mm", "bar", None, None]


def test_row_groups_follow_each_other(log):
    values = np.random.default_rng(2).normal(size=1000)
    np.testing.assert_array_equal(
        read(log({"x": values}, row_group_size=64), ALL).channels["x"].values, values
    )


def test_a_name_that_is_there_twice_is_refused(tmp_path):
    twice = pa.Table.from_arrays([pa.array([1.0, 2.0]), pa.array([3.0, 4.0])], names=["x", "x"])
    parquet.write_table(twice, tmp_path / "log.parquet")
    with pytest.raises(LogError, match="column 'x': several"):
        read(tmp_path / "log.parquet", ALL)


def test_no_cut_passes(tmp_path):
    write_table(tmp_path / "log.parquet", table())
    assert cut_everywhere(tmp_path / "log.parquet", read) > 120


def test_damaged_samples_are_found_by_their_checksum(tmp_path):
    path = tmp_path / "log.parquet"
    write_table(path, {"x": np.random.default_rng(4).normal(size=500)})
    whole = path.read_bytes()
    page = parquet.ParquetFile(path).metadata.row_group(0).column(0)
    for at in range(page.data_page_offset + 80, page.data_page_offset + page.total_compressed_size, 97):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        with pytest.raises(LogError, match="Parquet"):
            read(path, ALL)


def test_a_file_of_an_old_pandas_is_read():
    content = read(sample("pyarrow", "tests", "data", "parquet", "v0.7.1.parquet"), ALL)
    assert list(content.channels)[:4] == ["carat", "depth", "table", "price"]
    assert content.channels["carat"].values.size == 10
