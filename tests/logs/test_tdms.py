"""TDMS files: exact round trips, what LabVIEW writes, and nothing shortened without a word."""

import struct

import numpy as np
import pytest
from damaged import assert_same, cut_everywhere, sample, table
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.tdms import read, write_table

ALL = ChannelSelection("time_s", None)
SEGMENT = struct.Struct("<4sIIQQ")


@pytest.fixture
def log(tmp_path):
    """Return a function that writes segments of channels and returns the file's path."""

    def save(*segments):
        with TdmsWriter(tmp_path / "log.tdms") as writer:
            for objects in segments:
                writer.write_segment(objects)
        return tmp_path / "log.tdms"

    return save


def waveform(name, values, **properties):
    stated = {"wf_increment": 0.01, "wf_start_offset": 0.0, "wf_samples": len(values)}
    return ChannelObject("Bench", name, np.asarray(values), {**stated, **properties})


def test_a_written_table_reads_back_bit_for_bit(tmp_path):
    columns = table()
    write_table(tmp_path / "log.tdms", columns)
    content = read(tmp_path / "log.tdms", ChannelSelection("time_s", ("stroke_mm", "current_mA", "x")))
    assert_same(content, columns)
    assert [channel.unit for channel in content.channels.values()] == ["s", "mm", "mA", None]
    assert content.source == tmp_path / "log.tdms"


def test_every_channel_is_listed_by_group_and_name(log):
    text = ChannelObject("Bench", "note", ["a", "b", "c"])
    objects = [
        RootObject({"operator": "A"}),
        GroupObject("Bench", {"rate": 100}),
        ChannelObject("Bench", "stroke", np.arange(3.0), {"unit_string": " mm "}),
        ChannelObject("Bench", "count", np.arange(3, dtype=np.uint16), {"unit_string": ""}),
        ChannelObject("Other", "single", np.array([0.1, 0.2], dtype=np.float32)),
        ChannelObject("Other", "one", np.array([1.0])),
        ChannelObject("Other", "complex", np.ones(3) * 1j),
        ChannelObject("Other", "Dev1/ai0", np.arange(2) > 0),
        text,
    ]
    channels = read(log(objects), ALL).channels
    assert list(channels) == ["Bench/stroke", "Bench/count", "Other/single", "Other/Dev1/ai0"]
    assert [channel.unit for channel in channels.values()] == ["mm", None, None, None]
    assert all(channel.values.dtype == np.float64 for channel in channels.values())
    np.testing.assert_array_equal(channels["Other/single"].values, np.float32([0.1, 0.2]))
    np.testing.assert_array_equal(channels["Other/Dev1/ai0"].values, [0.0, 1.0])


def test_waveforms_bring_their_clock_and_share_it(log):
    path = log([waveform("a", range(5)), waveform("b", range(5)), waveform("c", range(3), wf_increment=0.5)])
    channels = read(path, ChannelSelection("time_s", ("a", "b", "c"))).channels
    assert list(channels) == ["a", "b", "c"]
    np.testing.assert_array_equal(channels["a"].clock_s, 0.01 * np.arange(5))
    assert channels["a"].clock_s is channels["b"].clock_s
    np.testing.assert_array_equal(channels["c"].clock_s, [0.0, 0.5, 1.0])


def test_waveforms_that_start_later_are_later(log):
    start = np.datetime64("2024-05-01T10:00:00.000000")
    path = log(
        [
            waveform("a", range(3), wf_start_time=start, wf_start_offset=1.0),
            waveform("b", range(3), wf_start_time=start + np.timedelta64(250, "ms")),
        ]
    )
    channels = read(path, ALL).channels
    np.testing.assert_allclose(channels["Bench/a"].clock_s, [1.0, 1.01, 1.02], rtol=0, atol=1e-12)
    np.testing.assert_allclose(channels["Bench/b"].clock_s, [0.25, 0.26, 0.27], rtol=0, atol=1e-9)


def test_waveforms_of_which_some_start_nobody_knows_when_are_refused(log):
    start = np.datetime64("2024-05-01T10:00:00.000000")
    path = log([waveform("a", range(3), wf_start_time=start), waveform("b", range(3))])
    with pytest.raises(LogError, match=r"column 'Bench/b': .*start time"):
        read(path, ChannelSelection("time_s", ("a", "b")))
    assert list(read(path, ChannelSelection("time_s", ("b",))).channels) == ["b"]


def test_a_recording_that_was_appended_is_refused(log):
    start = np.datetime64("2024-05-01T10:00:00.000000")
    later = start + np.timedelta64(1, "h")
    first = [waveform(name, range(3), wf_start_time=start) for name in "ab"]
    assert list(read(log(first, [waveform("b", range(3))]), ALL).channels) == ["Bench/a", "Bench/b"]
    path = log(first, [waveform("b", range(3), wf_start_time=later)])
    with pytest.raises(LogError, match=r"several recordings.*segment 2"):
        read(path, ALL)


@pytest.mark.parametrize(
    "properties",
    [{"wf_increment": 0.0}, {"wf_increment": np.nan}, {"wf_xunit_string": "Hz"}],
    ids=["no step", "no number", "a spectrum"],
)
def test_a_waveform_not_over_time_has_no_clock(log, properties):
    path = log([waveform("a", range(3), **properties)])
    assert read(path, ALL).channels["Bench/a"].clock_s is None
    with pytest.raises(
        LogError,
        match=r"column 'time_s': there is no such channel; .*; found Bench/a",
    ):
        read(path, ChannelSelection("time_s", ("a",)))


def test_a_channel_without_clock_requires_the_time(log):
    path = log([waveform("a", range(3)), ChannelObject("Bench", "b", np.arange(3.0))])
    assert list(read(path, ChannelSelection("time_s", ("a",))).channels) == ["a"]
    with pytest.raises(LogError, match="column 'time_s'"):
        read(path, ChannelSelection("time_s", ("a", "b")))


def test_time_stamps_turn_into_seconds_since_the_first(log):
    stamps = np.datetime64("2024-05-01T10:00:00.5") + np.arange(4) * np.timedelta64(10_000, "us")
    path = log([ChannelObject("Bench", "Time", stamps), ChannelObject("Bench", "x", np.arange(4.0))])
    time = read(path, ChannelSelection("Time", ("x",))).channels["Time"]
    assert (time.unit, time.clock_s) == ("s", None)
    np.testing.assert_allclose(time.values, [0.0, 0.01, 0.02, 0.03], rtol=0, atol=1e-12)


def test_segments_follow_each_other(log):
    parts = [[ChannelObject("Bench", "x", np.arange(5.0) + 10 * k)] for k in range(4)]
    values = read(log(*parts), ALL).channels["Bench/x"].values
    np.testing.assert_array_equal(values, np.concatenate([np.arange(5.0) + 10 * k for k in range(4)]))


def interleaved(path, samples=50):
    """Write two channels whose samples alternate, as LabVIEW does for one buffer of several channels."""

    def text(value):
        return struct.pack("<I", len(value)) + value.encode()

    def channel(name):
        return text(f"/'Bench'/'{name}'") + struct.pack("<IIIQ", 20, 10, 1, samples) + struct.pack("<I", 0)

    metadata = struct.pack("<I", 2) + channel("a") + channel("b")
    rows = np.stack([np.arange(samples) / 3, -np.arange(samples) / 7], axis=1)
    length = len(metadata) + rows.nbytes
    path.write_bytes(SEGMENT.pack(b"TDSm", 0b101110, 4713, length, len(metadata)) + metadata + rows.tobytes())
    return rows


def test_interleaved_samples_are_told_apart_and_no_cut_passes(tmp_path):
    rows = interleaved(tmp_path / "log.tdms")
    channels = read(tmp_path / "log.tdms", ALL).channels
    np.testing.assert_array_equal(channels["Bench/a"].values, rows[:, 0])
    np.testing.assert_array_equal(channels["Bench/b"].values, rows[:, 1])
    assert cut_everywhere(tmp_path / "log.tdms", read) > 100


def test_no_cut_within_a_segment_passes(log):
    parts = [[ChannelObject("Bench", name, np.arange(40.0)) for name in "ab"] for _ in range(3)]
    path = log(*parts)
    whole, ends, position = path.read_bytes(), [], 0
    while position < len(whole):
        position += SEGMENT.size + SEGMENT.unpack_from(whole, position)[3]
        ends.append(position)
    assert len(ends) == 3
    # Cut between two segments, a file is one that was recorded for less long: nothing in it says otherwise.
    assert cut_everywhere(path, read, cuts=400, whole_at=ends) > 350
    path.write_bytes(whole[: ends[1] - 1])
    with pytest.raises(LogError, match=rf"truncated: segment 2 .*byte {ends[1]}.* \d+$"):
        read(path, ALL)


def test_a_segment_that_was_never_finished_is_refused(log):
    path = log([ChannelObject("Bench", "x", np.arange(40.0))])
    whole = path.read_bytes()
    path.write_bytes(whole[:12] + b"\xff" * 8 + whole[20:])
    with pytest.raises(LogError, match=r"truncated: segment 1 .*never finished"):
        read(path, ALL)


@pytest.mark.parametrize("less", [4, 8, 160])
def test_a_segment_with_less_data_than_its_metadata_promise_is_refused(log, less):
    path = log([ChannelObject("Bench", "x", np.arange(40.0))])
    whole = path.read_bytes()
    length = SEGMENT.unpack_from(whole)[3]
    path.write_bytes(whole[:12] + struct.pack("<Q", length - less) + whole[20:-less])
    with pytest.raises(LogError, match=r"column 'Bench/x': .*truncated: .*\d+ of 40"):
        read(path, ALL)


def test_a_segment_in_between_that_ends_within_a_sample_is_refused(log):
    path = log(*([ChannelObject("Bench", "x", np.arange(40.0))] for _ in range(2)))
    whole = path.read_bytes()
    length = SEGMENT.unpack_from(whole)[3]
    end = SEGMENT.size + length
    path.write_bytes(whole[:12] + struct.pack("<Q", length - 4) + whole[20 : end - 4] + whole[end:])
    with pytest.raises(LogError, match=r"632 bytes.*636"):
        read(path, ALL)


def test_an_index_of_another_recording_beside_the_log_is_left_alone(log, tmp_path):
    path = log([ChannelObject("Bench", "x", np.arange(40.0))])
    (tmp_path / "log.tdms_index").write_bytes(b"TDSh" + path.read_bytes()[4:60])
    np.testing.assert_array_equal(read(path, ALL).channels["Bench/x"].values, np.arange(40.0))


@pytest.mark.parametrize("name", ["big_endian", "raw1", "Digital_Input", "raw_timestamps"])
def test_files_of_labview_are_read(name):
    content = read(sample("nptdms", "test", "data", f"{name}.tdms"), ALL)
    assert content.channels
    for channel in content.channels.values():
        assert channel.values.size > 1
        assert np.isfinite(channel.values).all()
