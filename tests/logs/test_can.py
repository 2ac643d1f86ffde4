"""CAN logs: cantools and the rules of J1939 are the truth, and nothing cut short passes for whole."""

import gzip
import struct
from pathlib import Path

import can
import numpy as np
import pytest
from can_logs import EXTENDED, PROTOCOL, frame, logged, marked, message, truth, wanted, write_dbc

from hitchid.errors import LogError
from hitchid.logs.formats import known_format
from hitchid.logs.formats.can import is_bus_log, read, read_bus
from hitchid.logs.formats.can_database import CanSignal, parameter_group
from hitchid.logs.formats.can_decoder import Frame, available

KINDS = (".asc", ".blf", ".mf4", ".trc", ".log")
ALL_FRAMES = tuple(kind for kind in KINDS if kind != ".trc")  # python-can writes no others to it
EPS = float(np.finfo(float).eps)
PLAIN = (
    message(
        0x123,
        "Hitch",
        'Position : 0|16@1+ (0.01,-20) [0|0] "mm" ECU',
        'Pressure : 23|12@0+ (0.25,0) [0|0] "bar" ECU',
        'Current : 32|10@1- (0.005,0) [0|0] "A" ECU',
        'Count : 56|8@1+ (1,0) [0|0] "" ECU',
    ),
    message(0x200, "Other", 'Speed : 0|8@1+ (1,0) [0|0] "" ECU'),
)
EEC1 = EXTENDED | 0x0CF004FE
# Engine speed is SPN 190: bytes 4 and 5, 0.125 rpm a bit.
SPEED = 'EngSpeed : 24|16@1+ (0.125,0) [0|0] "rpm" ECU'
TORQUE = 'Torque : 16|8@1+ (1,-125) [0|0] "%" ECU'


def decode(frames, databases, *names):
    """Return the content of frames, of all signals where none is named."""
    return read_bus(frames, Path("log.asc"), wanted(*names, databases=databases))


def speeds(*raw, torque=125):
    return [struct.pack("<BBBHBBB", 0, 0, torque, speed, 0, 0, 0) for speed in raw]


def senders(*addresses):
    """Return frames of EEC1 from nodes by turns; each speed is made of the address and a number."""
    return [
        frame(0.01 * n, EXTENDED | 0x0CF00400 | address, *speeds(8 * (10 * address + n)))
        for n in range(6)
        for address in addresses
    ]


@pytest.fixture
def plain(tmp_path):
    return write_dbc(tmp_path / "plain.dbc", *PLAIN)


@pytest.fixture
def j1939(tmp_path):
    return write_dbc(tmp_path / "j1939.dbc", message(EEC1, "EEC1", TORQUE, SPEED), behind=marked(EEC1))


@pytest.fixture
def hitch(plain):
    """Return frames that cantools encoded, and what it decodes of them."""
    kind = truth(plain).get_message_by_name("Hitch")
    rng = np.random.default_rng(1)
    frames, decoded = [frame(5.0, 0x200, bytes(8))], []
    for n in range(40):
        data = kind.encode(
            {
                "Position": rng.uniform(-20, 600),
                "Pressure": rng.uniform(0, 1000),
                "Current": rng.uniform(-2.5, 2.5),
                "Count": n,
            }
        )
        decoded.append(kind.decode(data))
        frames += [frame(5.005 + 0.01 * n, 0x123, data), frame(5.006 + 0.01 * n, 0x200, bytes([n] * 8))]
    return frames, {name: [values[name] for values in decoded] for name in decoded[0]}


# --- numbers ----------------------------------------------------------------------------------------------


def layout(rng, name, bits):
    """Return a signal of a DBC that lies anywhere in a message of 8 bytes."""
    intel = rng.integers(2)
    first = int(rng.integers(64 - bits + 1))
    start = first if intel else 8 * (first // 8) + 7 - first % 8
    scale, offset = rng.choice(["1", "2", "0.125", "-0.1", "1E-3"]), rng.choice(["0", "-40", "0.5"])
    return f'{name} : {start}|{bits}@{intel}{rng.choice(["+", "-"])} ({scale},{offset}) [0|0] "" ECU'


@pytest.mark.parametrize("seed", range(2))
def test_any_layout_gives_what_cantools_decodes(tmp_path, seed):
    rng = np.random.default_rng(seed)
    lengths = [int(n) for n in rng.permutation(np.tile(np.arange(1, 65), 2))]
    database = write_dbc(
        tmp_path / "any.dbc", *(message(n, f"M{n}", layout(rng, "S", bits)) for n, bits in enumerate(lengths))
    )
    payloads = [rng.integers(0, 256, 8, dtype=np.uint8).tobytes() for _ in range(6)] + [b"\xff" * 8]
    frames = [frame(0.0, n, data) for n in range(len(lengths)) for data in payloads]
    channels = decode(frames, [database]).channels
    for kind in truth(database).messages:
        # Beyond 2**53 the order of roundings differs.
        rounding = EPS if kind.signals[0].length > 50 else 0.0
        expected = [float(kind.decode(data, decode_choices=False)["S"]) for data in payloads]
        np.testing.assert_allclose(channels[f"{kind.name}/S"].values, expected, rtol=rounding, atol=0)


@pytest.mark.parametrize(("bits", "kind", "code"), [(32, 1, "f"), (64, 2, "d")])
def test_floating_numbers_are_read(tmp_path, bits, kind, code):
    database = write_dbc(
        tmp_path / "f.dbc",
        message(1, "A", f'x : 0|{bits}@1- (2,1) [0|0] "" ECU'),
        behind=f"SIG_VALTYPE_ 1 x : {kind};\n",
    )
    frames = [frame(0.1 * n, 1, struct.pack("<" + code, n / 8).ljust(8, b"\0")) for n in range(5)]
    read = decode(frames, [database], "x").channels["x"]
    np.testing.assert_array_equal(read.values, 1 + np.arange(5) / 4)


@pytest.mark.parametrize("kind", [*KINDS, ".asc.gz"])
def test_logs_of_every_kind_give_what_was_encoded(tmp_path, plain, hitch, kind):
    frames, decoded = hitch
    path = logged(frames, tmp_path / f"log{kind.removesuffix('.gz')}")
    if kind.endswith(".gz"):
        path = tmp_path / "log.asc.gz"
        path.write_bytes(gzip.compress((tmp_path / "log.asc").read_bytes()))
    content = read(path, wanted("Position", "Hitch/Pressure", "Current", "Count", databases=[plain]))
    assert (content.source, content.notices, content.line_of(0)) == (path, (), None)
    assert list(content.channels) == ["Position", "Hitch/Pressure", "Current", "Count"]
    for name, channel in content.channels.items():
        np.testing.assert_array_equal(channel.values, decoded[name.removeprefix("Hitch/")])
        # The text format keeps microseconds.
        np.testing.assert_allclose(channel.clock_s, 0.005 + 0.01 * np.arange(40), rtol=0, atol=1.1e-6)
        assert channel.clock_s is content.channels["Count"].clock_s
    assert [channel.unit for channel in content.channels.values()] == ["mm", "bar", "A", None]


def test_by_default_every_signal_that_comes_is_read(plain, hitch):
    frames, decoded = hitch
    channels = decode(frames, [plain]).channels
    assert set(channels) == {*(f"Hitch/{name}" for name in decoded), "Other/Speed"}
    np.testing.assert_array_equal(channels["Other/Speed"].values, [0, *range(40)])
    only = [sent for sent in frames if sent.identifier == 0x200]
    assert list(decode(only, [plain]).channels) == ["Other/Speed"]


@pytest.mark.parametrize("kind", ALL_FRAMES)
def test_frames_of_64_bytes_are_read(tmp_path, kind):
    database = write_dbc(tmp_path / "fd.dbc", message(7, "F", 'x : 480|16@1+ (1,0) [0|0] "" ECU', length=64))
    frames = [frame(0.01 * n, 7, bytes(60) + struct.pack("<HH", 1000 + n, 0)) for n in range(5)]
    path = logged(frames, tmp_path / f"log{kind}")
    content = read(path, wanted("x", databases=[database]))
    np.testing.assert_array_equal(content.channels["x"].values, 1000 + np.arange(5))


# --- multiplexers -----------------------------------------------------------------------------------------

MUX = message(
    3,
    "Mux",
    'Page M : 0|8@1+ (1,0) [0|0] "" ECU',
    'Low m0 : 8|8@1+ (1,0) [0|0] "" ECU',
    'Also m0 : 24|8@1+ (1,0) [0|0] "" ECU',
    'Inner m1M : 8|8@1+ (1,0) [0|0] "" ECU',
    'Deep m5 : 16|8@1+ (1,0) [0|0] "" ECU',
    'Never m9 : 16|8@1+ (1,0) [0|0] "" ECU',
    'Always : 56|8@1+ (1,0) [0|0] "" ECU',
)
SELECTED = ("Low Page 0-0", "Also Page 0-0", "Inner Page 1-1", "Deep Inner 5-6", "Never Page 9-9")
RANGES = "".join(f"SG_MUL_VAL_ 3 {values};\n" for values in SELECTED)


def test_a_multiplexer_says_which_frames_hold_a_signal(tmp_path):
    database = write_dbc(tmp_path / "mux.dbc", MUX, behind=RANGES)
    kind = truth(database).get_message_by_name("Mux")
    # Page 7 is not in the database: what does not hang on it is still good.
    pages = [(0, 40), (1, 5), (7, 5), (1, 6), (1, 4), (0, 41)]
    frames = [frame(n, 3, [page, low, 50 + n, 9, 0, 0, 0, n]) for n, (page, low) in enumerate(pages)]
    names = ("Low", "Also", "Inner", "Deep", "Always")
    channels = decode(frames, [database], *names).channels
    expected = {name: ([], []) for name in names}
    for n in (0, 1, 3, 5):
        for name, value in kind.decode(frames[n].data, allow_truncated=True).items():
            expected.get(name, ([], []))[0].append(n)
            expected.get(name, ([], []))[1].append(value)
    expected["Always"] = (list(range(6)), list(range(6)))
    expected["Inner"] = ([1, 3, 4], [5, 6, 4])
    for name, (times, values) in expected.items():
        assert times
        np.testing.assert_array_equal(channels[name].clock_s, times)
        np.testing.assert_array_equal(channels[name].values, values)
    assert channels["Low"].clock_s is channels["Also"].clock_s
    with pytest.raises(LogError, match=r"column 'Never': .*multiplexer"):
        decode(frames, [database], "Never")
    everything = decode(frames, [database])
    assert "Mux/Never" not in everything.channels
    assert "left out because no sample is valid: Mux/Never" in everything.notices


# --- J1939 ------------------------------------------------------------------------------------------------


def test_nodes_that_send_one_group_are_told_apart(j1939):
    for names in (("EEC1@0x00/EngSpeed", "EEC1@0x03/EngSpeed"), ()):
        channels = decode(senders(0, 3), [j1939], *names).channels
        for address in (0, 3):
            speed = channels[f"EEC1@{address:#04x}/EngSpeed"]
            np.testing.assert_array_equal(speed.values, 10 * address + np.arange(6))
            np.testing.assert_allclose(speed.clock_s, 0.01 * np.arange(6), rtol=EPS)
    for ambiguous in ("EngSpeed", "EEC1/EngSpeed"):
        nodes = "EEC1@0x00/EngSpeed, EEC1@0x03/EngSpeed"
        with pytest.raises(
            LogError, match=f"'{ambiguous}': several channels have this name; use the full name: {nodes}"
        ):
            decode(senders(0, 3), [j1939], ambiguous)
    with pytest.raises(LogError, match=r"'EEC1@0x05/EngSpeed': .*no such"):
        decode(senders(0, 3), [j1939], "EEC1@0x05/EngSpeed")


@pytest.mark.parametrize(
    "name",
    ["EngSpeed", "EEC1/EngSpeed", "EEC1@0x03/EngSpeed", "EEC1@can1@0x03/EngSpeed", "EEC1@can1/EngSpeed"],
)
def test_one_node_may_be_named_or_not(j1939, name):
    content = decode(senders(3), [j1939], name)
    np.testing.assert_array_equal(content.channels[name].values, 30 + np.arange(6))
    assert list(decode(senders(3), [j1939]).channels) == [
        "EEC1/Torque",
        "EEC1/EngSpeed",
    ]


def test_a_group_is_known_whatever_its_destination_and_priority(tmp_path):
    # TSC1, group 0, goes to one node; 61443 and 61444 are two groups.
    tsc1, eec2 = EXTENDED | 0x0C0000FE, EXTENDED | 0x0CF003FE
    database = write_dbc(
        tmp_path / "j.dbc",
        *(
            message(group, f"G{n}", f'x{n} : 0|8@1+ (1,0) [0|0] "" ECU')
            for n, group in enumerate((tsc1, eec2))
        ),
        behind=marked(tsc1, eec2),
    )
    ids = [0x0C000003, 0x0C000F03, 0x18000F03, 0x0CF00303, 0x0CF00403, 0x0D000003, 0x0C000003]
    frames = [frame(n, EXTENDED | identifier, [n] * 8) for n, identifier in enumerate(ids)]
    frames.append(frame(9, 0x003, [9] * 8))
    channels = decode(frames, [database], "x0", "x1").channels
    np.testing.assert_array_equal(channels["x0"].values, [0, 1, 2, 6])
    np.testing.assert_array_equal(channels["x1"].values, [3])
    assert [parameter_group(identifier) for identifier in (0x0CF00401, 0x18EF1234)] == [61444, 0xEF00]


def field(length, *, signed=False):
    return CanSignal("x", None, 0, length, True, signed, False, 1.0, 0.0, None, ())


@pytest.mark.parametrize(
    ("length", "signed", "last"),
    [
        (1, False, 1),
        (2, False, 0b01),
        (4, False, 13),
        (7, False, 125),
        (8, False, 0xFA),
        (8, True, 0xFE),
        (12, False, 0xFFE),
        (16, False, 0xFAFF),
        (16, True, 0xFFFE),
        (24, False, 0xFAFFFF),
        (32, False, 0xFAFFFFFF),
        (64, False, 2**64 - 2),
    ],
)
def test_the_last_number_of_each_length_is_as_j1939_has_it(length, signed, last):
    full = 2**length - 1
    raw = np.array(sorted({0, last, min(last + 1, full), full}), dtype=np.uint64)
    np.testing.assert_array_equal(available(raw, field(length, signed=signed)), raw <= np.uint64(last))


def test_unavailable_samples_are_left_out_of_their_own_signal(j1939):
    raw = [0xFFFF, 800, 0xFE00, 0xFB00, 0xFAFF, 808]
    frames = [frame(0.1 * n, EXTENDED | 0x0CF00400, data) for n, data in enumerate(speeds(*raw))]
    content = decode(frames, [j1939], "EngSpeed", "Torque")
    speed = content.channels["EngSpeed"]
    np.testing.assert_array_equal(speed.values, [100.0, 0xFAFF / 8, 101.0])
    np.testing.assert_allclose(speed.clock_s, [0.1, 0.4, 0.5], rtol=4 * EPS)
    assert content.channels["Torque"].values.size == 6
    assert content.notices == ("'EngSpeed': 3 of 6 samples are left out: not valid in J1939",)


def test_a_signal_never_available_is_refused_where_it_is_required(j1939):
    frames = [frame(0.1 * n, EXTENDED | 0x0CF00400, *speeds(0xFFFF)) for n in range(4)]
    with pytest.raises(LogError, match=r"'EngSpeed': .*4 samples.*'not available'"):
        decode(frames, [j1939], "EngSpeed")
    content = decode(frames, [j1939])
    assert list(content.channels) == ["EEC1/Torque"]
    assert content.notices == ("left out because no sample is valid: EEC1/EngSpeed",)


def test_ids_of_29_bits_are_met_exactly_where_nothing_says_j1939(tmp_path):
    own = EXTENDED | 0x18FF1000
    database = write_dbc(tmp_path / "own.dbc", message(own, "Own", 'x : 0|8@1+ (1,0) [0|0] "" ECU'))
    frames = [frame(n, EXTENDED | 0x18FF1000 | n % 2, [0xF0 + n] * 8) for n in range(6)]
    read = decode(frames, [database], "x")
    np.testing.assert_array_equal(read.channels["x"].values, [0xF0, 0xF2, 0xF4])
    with pytest.raises(
        LogError,
        match=r"'x': the message 'Own' of this signal, id 0x18ff1000, .*PGN 65296 are in the log, from "
        r"source address 0x01.*J1939PG",
    ):
        decode(frames[1::2], [database], "x")


def test_an_id_of_no_node_stands_for_all_others(tmp_path):
    database = write_dbc(tmp_path / "null.dbc", message(EEC1, "EEC1", SPEED))
    content = decode(senders(0), [database], "EngSpeed")
    np.testing.assert_array_equal(content.channels["EngSpeed"].values, np.arange(6))
    assert content.notices == (
        "'EEC1' was matched by its PGN 61444, from source address 0x00: "
        "the id in the DBC file, 0xcf004fe, has the null address",
    )
    content = decode(senders(0, 0xFE), [database], "EngSpeed")
    np.testing.assert_array_equal(content.channels["EngSpeed"].values, 10 * 0xFE + np.arange(6))
    assert content.notices == ()
    database = write_dbc(tmp_path / "said.dbc", message(EEC1, "EEC1", SPEED), behind=marked())
    with pytest.raises(LogError, match="is not in the log"):
        decode(senders(0), [database], "EngSpeed")


def test_a_whole_database_may_be_of_j1939(tmp_path):
    of_engine = EXTENDED | 0x0CF00400
    database = write_dbc(tmp_path / "all.dbc", message(of_engine, "EEC1", SPEED), behind=PROTOCOL)
    content = decode(senders(7), [database], "EngSpeed")
    np.testing.assert_array_equal(content.channels["EngSpeed"].values, 70 + np.arange(6))
    assert content.notices == ()


def test_a_database_may_tell_nodes_apart_by_itself(tmp_path):
    first, second = EXTENDED | 0x0CF00400, EXTENDED | 0x0CF00403
    database = write_dbc(
        tmp_path / "two.dbc",
        message(first, "Engine", SPEED),
        message(second, "Gear", 'Half : 24|16@1+ (0.0625,0) [0|0] "rpm" ECU'),
        behind=marked(first, second),
    )
    channels = decode(senders(0, 3, 9), [database]).channels
    assert list(channels) == ["Engine/EngSpeed", "Gear/Half"]
    np.testing.assert_array_equal(channels["Gear/Half"].values, (30 + np.arange(6)) / 2)


# --- buses, databases -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_buses_are_told_apart(tmp_path, plain, kind):
    frames = [frame(0.01 * n, 0x200, [10 * bus + n] * 8, bus=bus) for n in range(5) for bus in (1, 2)]
    path = logged([*frames, frame(0.06, 0x123, bytes(8))], tmp_path / f"log{kind}")
    channels = read(path, wanted("Other@can1/Speed", "Other@can2/Speed", "Count", databases=[plain])).channels
    for bus in (1, 2):
        np.testing.assert_array_equal(channels[f"Other@can{bus}/Speed"].values, 10 * bus + np.arange(5))
    for ambiguous in ("Speed", "Other/Speed"):
        with pytest.raises(LogError, match="Other@can1/Speed, Other@can2/Speed"):
            read(path, wanted(ambiguous, databases=[plain]))


def test_buses_and_nodes_are_told_apart_together(j1939):
    frames = [sent._replace(bus=bus) for bus in (1, 2) for sent in senders(0, 3)]
    names = set(decode(frames, [j1939]).channels)
    assert {name for name in names if name.endswith("EngSpeed")} == {
        f"EEC1@can{bus}@{address}/EngSpeed" for bus in (1, 2) for address in ("0x00", "0x03")
    }
    with pytest.raises(LogError, match="EEC1@can1@0x00/EngSpeed, EEC1@can1@0x03"):
        decode(frames, [j1939], "EEC1@can1/EngSpeed")


def test_what_is_asked_for_says_which_database_is_meant(tmp_path, plain):
    twice = write_dbc(tmp_path / "copy.dbc", *PLAIN)
    other = write_dbc(tmp_path / "b.dbc", message(0x200, "Else", 'Level : 0|8@1+ (2,0) [0|0] "" ECU'))
    unlike = write_dbc(tmp_path / "c.dbc", message(0x200, "Other", 'Speed : 0|8@1+ (3,0) [0|0] "" ECU'))
    frames = [frame(0, 0x200, [5] * 8)]
    channels = decode(frames, [plain, twice, other], "Speed", "Level").channels
    assert [channels[name].values.tolist() for name in ("Speed", "Level")] == [[5.0], [10.0]]
    channels = decode(frames, [plain, unlike]).channels
    assert {name: channel.values.tolist() for name, channel in channels.items()} == {
        "plain.Other/Speed": [5.0],
        "c.Other/Speed": [15.0],
    }


def test_a_database_that_changes_is_read_anew(tmp_path):
    for scale in (1, 3):
        signal = f'x : 0|8@1+ ({scale},0) [0|0] "" ECU'
        database = write_dbc(tmp_path / "a.dbc", message(1, "A", signal))
        read = decode([frame(0, 1, [7] * 8)], [database], "x")
        assert read.channels["x"].values.tolist() == [7.0 * scale]


def test_overlapping_signals_are_read_and_signals_beyond_the_message_left_out(tmp_path):
    signals = [
        f'{name} : {place}|16@1+ (1,0) [0|0] "" ECU' for name, place in zip("xyz", (0, 8, 56), strict=True)
    ]
    database = write_dbc(tmp_path / "bad.dbc", message(1, "A", *signals))
    content = decode([frame(0, 1, [1, 2, 3, 4, 5, 6, 7, 8])], [database])
    assert {name: channel.values.tolist() for name, channel in content.channels.items()} == {
        "A/x": [0x0201],
        "A/y": [0x0302],
    }
    assert content.notices[0].startswith("bad.dbc: read with errors (")


def test_a_signal_of_more_than_64_bits_is_no_number(tmp_path):
    wide, narrow = 'wide : 0|72@1+ (1,0) [0|0] "" ECU', 'x : 80|8@1+ (1,0) [0|0] "" ECU'
    database = write_dbc(tmp_path / "a.dbc", message(1, "A", wide, narrow, length=12))
    read = decode([frame(0, 1, range(12))], [database])
    assert {name: channel.values.tolist() for name, channel in read.channels.items()} == {"A/x": [10.0]}


# --- what is left out, what is refused --------------------------------------------------------------------


@pytest.mark.parametrize("kind", ALL_FRAMES)
def test_error_frames_and_short_frames_are_counted(tmp_path, plain, kind):
    frames = [frame(0.01 * n, 0x123, bytes([n] * 8)) for n in range(5)]
    frames[2] = frames[2]._replace(data=bytes(5))
    frames.insert(1, Frame(0.005, 1, 0, True, None))
    path = logged(frames, tmp_path / f"log{kind}")
    content = read(path, wanted("Count", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Count"].values, [0, 1, 3, 4])
    assert content.notices == (
        "1 error and remote frames are left out",
        "'Hitch': 1 of 5 frames are left out: shorter than 8 bytes",
    )


def test_remote_frames_are_no_data(tmp_path, plain):
    with can.BLFWriter(tmp_path / "log.blf") as log:
        for stamp_s, kind in ((1.0, {"is_remote_frame": True, "dlc": 8}), (2.0, {"data": bytes(8)})):
            log(can.Message(timestamp=stamp_s, arbitration_id=0x123, is_extended_id=False, **kind))
    content = read(tmp_path / "log.blf", wanted("Count", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Count"].clock_s, [0.0])
    assert content.notices == ("1 error and remote frames are left out",)


@pytest.mark.parametrize(
    ("frames", "names", "message"),
    [
        ([frame(0, 0x123, bytes(7))], ("Count",), r"'Count': .*8 bytes"),
        ([Frame(0.0, 1, 0, False, None)], (), "holds no CAN frames with data"),
        ([frame(0, 0x7FF, bytes(8))], (), "1 frames"),
        (
            [frame(0, 0x7FF, bytes(8))],
            ("Count",),
            r"'Count': the message 'Hitch' of this signal, id 0x123, is not in the log$",
        ),
        ([frame(0, 0x200, bytes(8))], ("Nothing",), r"'Nothing': .*Other/Speed"),
    ],
    ids=["short frames alone", "no data", "unknown frames", "a message that is missing", "no such signal"],
)
def test_a_log_without_the_frames_that_are_required_is_refused(plain, frames, names, message):
    with pytest.raises(LogError, match=message):
        decode(frames, [plain], *names)


def test_a_log_whose_database_is_missing_is_refused(tmp_path):
    with pytest.raises(
        LogError, match=r"log\.asc: a DBC file is required: put it in the log's folder or name it in camp"
    ):
        decode([], [], "x")
    with pytest.raises(LogError, match=r"none\.dbc: cannot be read"):
        decode([], [tmp_path / "none.dbc"])


DAMAGED = {
    "empty": b"",
    "noise": bytes(range(256)) * 4,
    "words": b"BO_ 1 A: 8 X\n SG_ x : nonsense",
    "no signals": b'VERSION ""\n',
    "an id of 30 bits": b'VERSION ""\nBU_: X\nBO_ 4294967295 A: 8 X\n SG_ x : 0|8@1+ (1,0) [0|0] "" X\n',
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED.keys())
def test_a_damaged_database_is_refused_by_its_name(tmp_path, content):
    (tmp_path / "bad.dbc").write_bytes(content)
    with pytest.raises(LogError, match=r"bad\.dbc: "):
        decode([frame(0, 1, bytes(8))], [tmp_path / "bad.dbc"])


# --- logs that were cut short, by format ------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"compression_level": 0}, {"max_container_size": 500}])
def test_a_cut_blf_log_is_refused_unless_it_ends_between_objects(tmp_path, plain, options):
    path = tmp_path / "log.blf"
    with can.BLFWriter(path, **options) as log:
        for n in range(60):
            log(can.Message(timestamp=0.01 * n, arbitration_id=0x200, is_extended_id=False, data=[n] * 8))
    whole = bytearray(path.read_bytes())
    assert read(path, wanted("Speed", databases=[plain])).channels["Speed"].values.size == 60
    for size in range(0, len(whole), 17):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"log\.blf: "):
            read(path, wanted("Speed", databases=[plain]))
    # Size of file and count of objects as they stand until the log is closed: then a shorter log is whole.
    whole[16:36] = struct.pack("<QQL", 144, 144, 0)
    read_whole = 0
    for size in (*range(144, len(whole), 11), *range(len(whole) - 50, len(whole) + 1)):
        path.write_bytes(whole[:size])
        try:
            content = read(path, wanted("Speed", databases=[plain]))
        except LogError:
            continue
        values = content.channels["Speed"].values
        np.testing.assert_array_equal(values, np.arange(values.size))
        assert content.notices == ("the log was never closed: it may be incomplete",)
        read_whole += values.size == 60
    assert read_whole >= 1


def test_a_damaged_blf_log_is_refused_or_whole(tmp_path, plain):
    path = logged([frame(0.01 * n, 0x200, [n] * 8) for n in range(60)], tmp_path / "log.blf")
    whole = path.read_bytes()
    refused = 0
    places = range(144, len(whole), 5)
    for at in places:
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            values = read(path, wanted("Speed", databases=[plain])).channels["Speed"].values
        except LogError:
            refused += 1
        else:
            np.testing.assert_array_equal(values, np.arange(60))
    assert refused > len(places) // 2


def test_an_asc_log_cut_anywhere_gives_no_false_number(tmp_path, plain):
    path = logged([frame(0.01 * n, 0x200, [0xA0 + n] * 8) for n in range(30)], tmp_path / "log.asc")
    whole = path.read_bytes()
    end = whole.index(b"End TriggerBlock")
    for size in [*range(0, end, 43), *range(end - 60, end + 4)]:
        path.write_bytes(whole[:size])
        try:
            content = read(path, wanted("Speed", databases=[plain]))
        except LogError:
            assert whole[:size].count(b"\n") < 6
            continue
        values = content.channels["Speed"].values
        np.testing.assert_array_equal(values, 0xA0 + np.arange(values.size))
        assert values.size == whole[:size].count(b"\n") - 5
        assert "the log has no 'End TriggerBlock': it may be incomplete" in content.notices


# --- the text format --------------------------------------------------------------------------------------

HEADER = "date Thu Jan 1 00:00:00.000 2026\nbase hex  timestamps absolute\ninternal events logged\n"
LINES = "".join(f" 0.0{n} 1  200  Rx   d 8 0{n} 00 00 00 00 00 00 00\n" for n in range(1, 6))
TEXTS = {
    "nothing more": HEADER + LINES,
    "windows": (HEADER + LINES).replace("\n", "\r\n"),
    "blank lines": "\n" + HEADER.replace("\n", "\n\n") + LINES,
    "no header": LINES,
    "no note of events": HEADER.replace("internal events logged\n", "") + LINES,
    "decimal": HEADER.replace("hex", "dec") + LINES.replace(" 200 ", " 512 "),
    "comments": HEADER + "// version 9.0.0\n" + LINES.replace("\n", "\n// p\xfcmpe\n"),
    "lengths behind": HEADER + LINES.replace("\n", "  Length = 250000 BitCount = 130 ID = 512\n"),
    "statistics": HEADER + LINES.replace("\n", "\n 0.06 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 1.0%\n"),
    "requests": HEADER + LINES + LINES.replace("Rx", "TxRq"),
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())
def test_text_logs_as_they_come(tmp_path, plain, text):
    (tmp_path / "log.asc").write_bytes(text.encode("latin-1"))
    content = read(tmp_path / "log.asc", wanted("Speed", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Speed"].values, [1, 2, 3, 4, 5])
    np.testing.assert_allclose(content.channels["Speed"].clock_s, 0.01 * np.arange(5), rtol=0, atol=4 * EPS)
    assert content.notices == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + LINES.replace("03 00", "0g 00"), r"log\.asc: line 6: .*CAN"),
        (
            HEADER.replace("absolute", "relative") + LINES,
            "relative to the previous line; expected 'base hex timestamps absolute'",
        ),
    ],
    ids=["a digit that is none", "relative stamps"],
)
def test_a_text_log_that_cannot_be_read_is_refused(tmp_path, plain, text, message):
    (tmp_path / "log.asc").write_text(text)
    with pytest.raises(LogError, match=message):
        read(tmp_path / "log.asc", wanted("Speed", databases=[plain]))


def test_a_line_that_misses_bytes_is_left_out(tmp_path, plain):
    (tmp_path / "log.asc").write_text(HEADER + LINES.replace("03 00", "03"))
    content = read(tmp_path / "log.asc", wanted("Speed", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Speed"].values, [1, 2, 4, 5])
    assert content.notices == ("'Other': 1 of 5 frames are left out: shorter than 8 bytes",)


CANDUMPS = {
    "log file": "(1700000000.01{n}000) can0 200#0{n}00000000000000\n",
    "directions": "(1700000000.01{n}000) can0 200#0{n}.00.00.00.00.00.00.00 R\n",
    "flexible data rate": "(1700000000.01{n}000) can0 200##10{n}00000000000000\n",
    "printed": " (1700000000.01{n}000)  can0  200   [8]  0{n} 00 00 00 00 00 00 00\n",
    "printed in full": " (1.01{n}000)  vcan0  TX B -  200   [8]  0{n} 00 00 00 00 00 00 00   '........'\r\n",
}


@pytest.mark.parametrize("line", CANDUMPS.values(), ids=CANDUMPS.keys())
def test_what_candump_writes_is_read_and_a_cut_line_left_out(tmp_path, plain, line):
    lines = "".join(line.replace("{n}", str(n)) for n in range(1, 6))
    for text, notices in ((lines, 0), (lines + line.replace("{n}", "6")[:40], 1), ("# rig 1\n" + lines, 1)):
        (tmp_path / "log.log").write_text(text)
        content = read(tmp_path / "log.log", wanted("Speed", databases=[plain]))
        np.testing.assert_array_equal(content.channels["Speed"].values, [1, 2, 3, 4, 5])
        np.testing.assert_allclose(content.channels["Speed"].clock_s, 0.001 * np.arange(5), rtol=0, atol=1e-6)
        assert len(content.notices) == notices


def test_a_text_named_log_is_one_only_if_from_candump(tmp_path):
    (tmp_path / "server.log").write_text("2026-11-21 12:00:00 started\n" * 30)
    (tmp_path / "bus.log").write_text(CANDUMPS["log file"].replace("{n}", "1"))
    assert known_format(tmp_path / "server.log") is None
    assert known_format(tmp_path / "bus.log") is not None


# --- MF4 --------------------------------------------------------------------------------------------------


def test_bus_logs_are_told_from_other_mf4_files(tmp_path):
    from asammdf import MDF, Signal

    path = logged([frame(0, 0x200, bytes(8))], tmp_path / "bus.mf4")
    assert is_bus_log(path)
    with MDF(version="4.10") as log:
        log.append(Signal(np.arange(5.0), np.arange(5.0), name="x"))
        log.save(tmp_path / "plain.mf4")
    assert not is_bus_log(tmp_path / "plain.mf4")
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(LogError, match=r"bus\.mf4: "):
        is_bus_log(path)


def test_a_bus_log_may_miss_fields_and_stand_in_several_groups(tmp_path, plain):
    from asammdf import MDF, Signal

    kind = [("CAN_DataFrame.ID", "<u4"), ("CAN_DataFrame.DLC", "u1"), ("CAN_DataFrame.DataBytes", "(8,)u1")]
    with MDF(version="4.10") as log:
        for own in (range(0, 6, 2), range(1, 6, 2)):
            samples = np.array([(0x200, 8, [n] * 8) for n in own], dtype=kind)
            log.append(Signal(samples, np.array(own, dtype=float), name="CAN_DataFrame"))
        log.append(
            Signal(
                np.array([(EXTENDED | 0x200, 8, [9] * 8)], dtype=kind), np.array([7.0]), name="CAN_DataFrame"
            )
        )
        log.save(tmp_path / "log.mf4")
    channel = read(tmp_path / "log.mf4", wanted("Speed", databases=[plain])).channels["Speed"]
    np.testing.assert_array_equal(channel.values, np.arange(6))
    np.testing.assert_array_equal(channel.clock_s, np.arange(6))


def test_a_bus_log_may_keep_fields_as_channels(tmp_path, plain):
    from asammdf import MDF, Signal

    stamps = np.arange(6.0)
    fields = {
        "ID": np.full(6, 0x200, dtype="<u4"),
        "IDE": np.zeros(6, dtype="u1"),
        "BusChannel": np.full(6, 2, dtype="u1"),
        "DataLength": np.array([8, 8, 0, 8, 8, 8], dtype="u1"),
        "DataBytes": np.tile(np.arange(6, dtype="u1")[:, None], (1, 8)),
    }
    with MDF(version="4.10") as log:
        log.append([Signal(values, stamps, name=f"CAN_DataFrame.{name}") for name, values in fields.items()])
        log.save(tmp_path / "log.mf4")
    assert is_bus_log(tmp_path / "log.mf4")
    content = read(tmp_path / "log.mf4", wanted("Other@can2/Speed", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Other@can2/Speed"].values, [0, 1, 3, 4, 5])
    assert content.notices == ("'Other': 1 of 6 frames are left out: shorter than 8 bytes",)
