"""MDF files: exact round trips, groups on their own clocks, conversions, nothing shortened silently."""

import numpy as np
import pytest
from asammdf import MDF, Signal
from asammdf.blocks.conversion_utils import from_dict
from damaged import assert_same, cut_everywhere, table

from hitchid.errors import InputError, LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.mdf import read, write_table

ALL = ChannelSelection("time_s", None)
FAST, SLOW = np.arange(200) / 100, np.arange(20) / 10
RANDOM = np.random.default_rng(7)
STROKE, PRESSURE = RANDOM.normal(size=200), RANDOM.normal(size=20)
VERSIONS = ["2.14", "3.30", "4.00", "4.11", "4.20"]


@pytest.fixture
def log(tmp_path):
    """Return a function that writes groups of signals under their names and returns the file's path."""

    def save(*groups, version="4.10", compression=0, suffix=".mf4", **options):
        with MDF(version=version, **options) as mdf:
            for name, signals in groups:
                mdf.append(signals, acq_name=name, comment="")
            return mdf.save(tmp_path / f"log{suffix}", overwrite=True, compression=compression)

    return save


def signal(name, values=STROKE, time=FAST, unit="", conversion=None, **options):
    converted = None if conversion is None else from_dict(conversion)
    return Signal(np.asarray(values), time, name=name, unit=unit, conversion=converted, **options)


@pytest.mark.parametrize("suffix", [".mf4", ".mdf"])
def test_a_written_table_reads_back_bit_for_bit(tmp_path, suffix):
    columns = table()
    write_table(tmp_path / f"log{suffix}", columns)
    content = read(tmp_path / f"log{suffix}", ChannelSelection("time_s", ("stroke_mm", "current_mA", "x")))
    assert list(content.channels) == ["stroke_mm", "current_mA", "x"]
    assert_same(content, columns)
    assert [channel.unit for channel in content.channels.values()] == ["mm", "mA", None]
    assert len({id(channel.clock_s) for channel in content.channels.values()}) == 1
    assert [path.name for path in tmp_path.iterdir()] == [f"log{suffix}"]


def test_a_table_is_written_over_another(tmp_path):
    write_table(tmp_path / "log.mf4", table(samples=500))
    write_table(tmp_path / "log.mf4", table(seed=9))
    assert_same(read(tmp_path / "log.mf4", ALL), {})
    assert read(tmp_path / "log.mf4", ALL).channels["log/x"].values.size == 60


@pytest.mark.parametrize(
    "columns", [{"x": STROKE}, {"time_s": FAST}, {}], ids=["no time", "only time", "none"]
)
def test_a_table_without_time_or_signals_is_not_written(tmp_path, columns):
    with pytest.raises(InputError, match="'time_s'"):
        write_table(tmp_path / "log.mf4", columns)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("version", VERSIONS)
def test_each_group_has_its_own_clock(log, version):
    fast = [signal("stroke", unit="mm"), signal("current", 2 * STROKE, unit="A")]
    slow = [signal("pressure", PRESSURE, SLOW, "bar")]
    suffix = ".mf4" if version >= "4" else ".mdf"
    content = read(log(("fast", fast), ("slow", slow), version=version, suffix=suffix), ALL)
    names = ["fast/stroke", "fast/current", "slow/pressure"]
    assert list(content.channels) == (names if version >= "4" else ["0/stroke", "0/current", "1/pressure"])
    stroke, current, pressure = content.channels.values()
    assert [channel.unit for channel in (stroke, current, pressure)] == ["mm", "A", "bar"]
    np.testing.assert_array_equal(stroke.values, STROKE)
    np.testing.assert_array_equal(stroke.clock_s, FAST)
    assert stroke.clock_s is current.clock_s
    np.testing.assert_array_equal(pressure.values, PRESSURE)
    np.testing.assert_array_equal(pressure.clock_s, SLOW)


def test_groups_without_a_name_of_their_own_go_by_number(log):
    path = log(("same", [signal("x")]), ("same", [signal("x")]), ("other", [signal("y"), signal("y")]))
    content = read(path, ALL)
    assert list(content.channels) == ["0/x", "1/x", "other/y", "other/y (2)"]
    with pytest.raises(
        LogError, match="column 'x': several channels have this name; use the full name: 0/x, 1/x"
    ):
        read(path, ChannelSelection("t", ("x",)))
    assert list(read(log((None, [signal("x")])), ALL).channels) == ["x"]


def test_what_holds_no_numbers_is_not_listed(log):
    text = Signal(np.array([b"on"] * 200), FAST, name="text", encoding="utf-8")
    one = signal("one", [1.0], [0.0])
    path = log(("g", [signal("x"), text, signal("flag", FAST > 1)]), ("h", [one]))
    assert list(read(path, ALL).channels) == ["g/x", "g/flag"]


def test_parts_of_an_array_are_channels(log):
    rows = np.stack([STROKE, 2 * STROKE, 3 * STROKE], axis=1)
    array = Signal(np.rec.fromarrays([rows], dtype=[("a", "<f8", (3,))]), FAST, name="a")
    channels = read(log(("g", [array])), ALL).channels
    assert list(channels) == ["g/a[0]", "g/a[1]", "g/a[2]"]
    for column, channel in enumerate(channels.values()):
        np.testing.assert_array_equal(channel.values, rows[:, column])


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", [np.int16, np.uint8, np.float32])
def test_scaled_numbers_are_scaled_in_doubles(log, version, kind):
    raw = np.arange(200).astype(kind)
    scaled = signal("x", raw, conversion={"a": 0.1, "b": -3.7})
    values = read(log(("g", [scaled]), version=version), ChannelSelection("t", ("x",))).channels["x"].values
    np.testing.assert_array_equal(values, raw.astype(float) * 0.1 - 3.7)


@pytest.mark.parametrize(("unit", "stated"), [("mm", "mm"), ("", "cm")])
def test_the_unit_of_a_conversion_counts_where_the_channel_has_none(log, unit, stated):
    # ASAM MDF 4, CCBLOCK: the channel's unit overwrites the conversion's.
    converted = signal("x", np.arange(200, dtype=np.int16), unit=unit, conversion={"a": 0.1, "b": 0.0})
    converted.conversion.unit = "cm"
    assert read(log(("g", [converted])), ChannelSelection("t", ("x",))).channels["x"].unit == stated


def test_a_rational_and_a_table_conversion_are_carried_out(log):
    rational = {"P1": 0, "P2": 2, "P3": 1, "P4": 0, "P5": 0, "P6": 4}
    points = {f"raw_{k}": v for k, v in enumerate((0, 100, 200))}
    points |= {f"phys_{k}": v for k, v in enumerate((0.0, 1.0, 5.0))}
    raw = np.arange(200, dtype=np.uint16)
    signals = [
        signal("r", raw, conversion=rational),
        signal("t", raw, conversion={**points, "interpolation": True}),
    ]
    channels = read(log(("g", signals)), ChannelSelection("t", ("r", "t"))).channels
    np.testing.assert_allclose(channels["r"].values, (2 * raw + 1) / 4, rtol=1e-15)
    np.testing.assert_allclose(channels["t"].values, np.interp(raw, [0, 100, 200], [0, 1, 5]), rtol=1e-15)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_state_whose_names_are_text_is_read_by_number(log, version):
    raw = (np.arange(200) % 2).astype(np.uint8)
    state = signal("mode", raw, conversion={"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on"})
    np.testing.assert_array_equal(
        read(log(("g", [state]), version=version), ChannelSelection("t", ("mode",))).channels["mode"].values,
        raw,
    )


def test_text_for_some_numbers_leaves_the_scale_of_the_others(log):
    raw = np.array([10, 20, 255, 30] * 50, dtype=np.uint8)
    scale = from_dict({"a": 0.5, "b": 0.0})
    fault = {
        "lower_0": 255,
        "upper_0": 255,
        "text_0": b"sensor fault",
        "default": scale,
        "default_addr": scale,
    }
    values = (
        read(log(("g", [signal("x", raw, conversion=fault)])), ChannelSelection("t", ("x",)))
        .channels["x"]
        .values
    )
    np.testing.assert_array_equal(values, np.where(raw == 255, np.nan, raw * 0.5))


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_formula_is_not_evaluated(log, version):
    formula = {"formula": "__import__('os').abort() + X1"}
    path = log(("g", [signal("x", conversion=formula), signal("y")]), version=version)
    with pytest.raises(LogError, match=r"column 'x': .*formula"):
        read(path, ChannelSelection("t", ("x",)))
    np.testing.assert_array_equal(read(path, ChannelSelection("t", ("y",))).channels["y"].values, STROKE)


def test_samples_marked_invalid_are_no_numbers(log):
    invalid = np.arange(200) % 10 == 3
    path = log(("g", [signal("x", invalidation_bits=invalid), signal("y")]))
    channels = read(path, ChannelSelection("t", ("x", "y"))).channels
    np.testing.assert_array_equal(channels["x"].values, np.where(invalid, np.nan, STROKE))
    np.testing.assert_array_equal(channels["y"].values, STROKE)
    assert channels["x"].clock_s.size == 200


def test_a_master_that_counts_an_angle_is_no_clock(log):
    over_angle = Signal(STROKE, FAST, name="x", master_metadata=("crank", 2))
    path = log(("g", [over_angle]))
    channels = read(path, ALL).channels
    assert list(channels) == ["g/crank", "g/x"]
    assert channels["g/x"].clock_s is None
    np.testing.assert_array_equal(channels["g/crank"].values, FAST)
    with pytest.raises(LogError, match=r"column 'time_s': .*no such"):
        read(path, ChannelSelection("time_s", ("x",)))


def test_a_master_that_is_not_in_the_file_counts_samples(log):
    path = log(("g", [signal("x")]))
    whole = bytearray(path.read_bytes())
    kinds = [at + 88 for at in range(len(whole)) if whole[at : at + 4] == b"##CN"]
    (master,) = (at for at in kinds if whole[at] == 2)
    whole[master] = 3
    path.write_bytes(whole)
    channels = read(path, ALL).channels
    assert list(channels) == ["g/x"]
    np.testing.assert_array_equal(channels["g/x"].values, STROKE)
    np.testing.assert_array_equal(channels["g/x"].clock_s, np.arange(200.0))


@pytest.mark.parametrize("compression", [0, 1, 2])
def test_long_and_compressed_groups_are_read_whole(log, compression):
    time = np.arange(60_000) / 1000
    values = np.random.default_rng(1).normal(size=time.size)
    path = log(("g", [signal("x", values, time)]), compression=compression)
    channel = read(path, ChannelSelection("t", ("x",))).channels["x"]
    np.testing.assert_array_equal(channel.values, values)
    np.testing.assert_array_equal(channel.clock_s, time)


@pytest.mark.parametrize("compression", [0, 2])
@pytest.mark.parametrize("options", [{"column_storage": True}, {"use_ld_blocks": True}], ids=str)
def test_data_lists_of_version_4_20_are_read(log, compression, options):
    invalid = np.arange(200) % 10 == 3
    signals = [signal("x"), signal("y", 2 * STROKE, invalidation_bits=invalid)]
    path = log(("g", signals), version="4.20", compression=compression, **options)
    channels = read(path, ChannelSelection("t", ("x", "y"))).channels
    np.testing.assert_array_equal(channels["x"].values, STROKE)
    np.testing.assert_array_equal(channels["y"].values, np.where(invalid, np.nan, 2 * STROKE))
    np.testing.assert_array_equal(channels["y"].clock_s, FAST)
    assert cut_everywhere(path, read, cuts=60) > 50


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("compression", [0, 2])
def test_no_cut_loses_samples(log, version, compression):
    fast = [
        signal("stroke"),
        signal("count", np.arange(200, dtype=np.int16), conversion={"a": 0.5, "b": 1.0}),
    ]
    path = log(("f", fast), ("s", [signal("p", PRESSURE, SLOW)]), version=version, compression=compression)
    assert cut_everywhere(path, read, cuts=150) > 120


def test_a_cut_names_where_it_is(tmp_path):
    write_table(tmp_path / "log.mf4", table())
    whole = (tmp_path / "log.mf4").read_bytes()
    (tmp_path / "log.mf4").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(LogError, match=r"truncated: .*byte \d+.* \d+$"):
        read(tmp_path / "log.mf4", ALL)


@pytest.mark.parametrize("change", [(0, b"UnFinMF "), (60, b"\x05")], ids=["by name", "by flags"])
def test_a_recording_that_was_never_finalized_is_read_with_a_notice(tmp_path, change):
    write_table(tmp_path / "log.mf4", table())
    whole, (at, mark) = (tmp_path / "log.mf4").read_bytes(), change
    (tmp_path / "log.mf4").write_bytes(whole[:at] + mark + whole[at + len(mark) :])
    content = read(tmp_path / "log.mf4", ALL)
    (tmp_path / "whole.mf4").write_bytes(whole)
    for name, channel in read(tmp_path / "whole.mf4", ALL).channels.items():
        np.testing.assert_array_equal(content.channels[name].values, channel.values)
        np.testing.assert_array_equal(content.channels[name].clock_s, channel.clock_s)
    (notice,) = content.notices
    assert "never finalized" in notice


def test_an_old_recording_never_finalized_is_refused(log):
    path = log(("g", [signal("x")]), version="4.00")
    path.write_bytes(b"UnFinMF " + path.read_bytes()[8:])
    with pytest.raises(LogError, match=r"truncated: .*never finished"):
        read(path, ALL)
