"""CAN logs: cantools and the rules of J1939 are the truth, and nothing cut short passes for whole."""

import gzip
import struct
import sys

import can
import numpy as np
import pytest
from can_logs import EXTENDED, PROTOCOL, frame, logged, marked, message, truth, wanted, write_dbc

from hitchid.errors import LogError
from hitchid.logs.formats import known_format
from hitchid.logs.formats.can import SUFFIXES, is_bus_log, read, read_bus, read_mf4
from hitchid.logs.formats.can_database import CanSignal, parameter_group
from hitchid.logs.formats.can_streams import Frame, available

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


def speeds(*raw, torque=125):
    return [struct.pack("<BBBHBBB", 0, 0, torque, each, 0, 0, 0) for each in raw]


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
def source(tmp_path):
    return tmp_path / "log.asc"


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
    return frames, {name: [each[name] for each in decoded] for name in decoded[0]}


# --- numbers ----------------------------------------------------------------------------------------------


def layout(rng, name, bits):
    """Return a signal of a DBC that lies anywhere in a message of 8 bytes."""
    intel = rng.integers(2)
    place = int(rng.integers(64 - bits + 1))
    start = place if intel else 8 * (place // 8) + 7 - place % 8
    scale, offset = rng.choice(["1", "2", "0.125", "-0.1", "1E-3"]), rng.choice(["0", "-40", "0.5"])
    return f'{name} : {start}|{bits}@{intel}{rng.choice(["+", "-"])} ({scale},{offset}) [0|0] "" ECU'


@pytest.mark.parametrize("seed", range(4))
def test_any_layout_gives_what_cantools_decodes(tmp_path, source, seed):
    rng = np.random.default_rng(seed)
    lengths = [int(n) for n in rng.permutation(np.tile(np.arange(1, 65), 2))]
    database = write_dbc(
        tmp_path / "any.dbc", *(message(n, f"M{n}", layout(rng, "S", bits)) for n, bits in enumerate(lengths))
    )
    payloads = [rng.integers(0, 256, 8, dtype=np.uint8).tobytes() for _ in range(6)] + [b"\xff" * 8]
    frames = [frame(0.0, n, data) for n in range(len(lengths)) for data in payloads]
    channels = read_bus(frames, source, wanted(databases=[database])).channels
    for kind in truth(database).messages:
        # Beyond 2**53 the order of roundings differs.
        rounding = EPS if kind.signals[0].length > 50 else 0.0
        expected = [float(kind.decode(data, decode_choices=False)["S"]) for data in payloads]
        np.testing.assert_allclose(channels[f"{kind.name}/S"].values, expected, rtol=rounding, atol=0)


@pytest.mark.parametrize(("bits", "kind", "code"), [(32, 1, "f"), (64, 2, "d")])
def test_floating_numbers_are_read(tmp_path, source, bits, kind, code):
    database = write_dbc(
        tmp_path / "f.dbc",
        message(1, "A", f'x : 0|{bits}@1- (2,1) [0|0] "" ECU'),
        behind=f"SIG_VALTYPE_ 1 x : {kind};\n",
    )
    frames = [frame(0.1 * n, 1, struct.pack("<" + code, n / 8).ljust(8, b"\0")) for n in range(5)]
    read = read_bus(frames, source, wanted("x", databases=[database])).channels["x"]
    np.testing.assert_array_equal(read.values, 1 + np.arange(5) / 4)


@pytest.mark.parametrize("kind", [*KINDS, ".asc.gz"])
def test_logs_of_every_kind_give_what_was_encoded(tmp_path, plain, hitch, kind):
    frames, decoded = hitch
    path = logged(frames, tmp_path / f"log{kind.removesuffix('.gz')}")
    if kind.endswith(".gz"):
        path = tmp_path / "log.asc.gz"
        path.write_bytes(gzip.compress((tmp_path / "log.asc").read_bytes()))
    reader = read_mf4 if kind == ".mf4" else read
    content = reader(path, wanted("Position", "Hitch/Pressure", "Current", "Count", databases=[plain]))
    assert (content.source, content.notices, content.line_of(0)) == (path, (), None)
    assert list(content.channels) == ["Position", "Hitch/Pressure", "Current", "Count"]
    for name, channel in content.channels.items():
        np.testing.assert_array_equal(channel.values, decoded[name.removeprefix("Hitch/")])
        # The text format keeps microseconds.
        np.testing.assert_allclose(channel.clock_s, 0.005 + 0.01 * np.arange(40), rtol=0, atol=1.1e-6)
        assert channel.clock_s is content.channels["Count"].clock_s
    assert [each.unit for each in content.channels.values()] == ["mm", "bar", "A", None]


def test_without_a_wish_every_signal_that_comes_is_read_under_its_full_name(plain, source, hitch):
    frames, decoded = hitch
    channels = read_bus(frames, source, wanted(databases=[plain])).channels
    assert set(channels) == {*(f"Hitch/{name}" for name in decoded), "Other/Speed"}
    np.testing.assert_array_equal(channels["Other/Speed"].values, [0, *range(40)])
    only = [each for each in frames if each.identifier == 0x200]
    assert list(read_bus(only, source, wanted(databases=[plain])).channels) == ["Other/Speed"]


@pytest.mark.parametrize("kind", ALL_FRAMES)
def test_frames_of_64_bytes_are_read(tmp_path, kind):
    database = write_dbc(tmp_path / "fd.dbc", message(7, "F", 'x : 480|16@1+ (1,0) [0|0] "" ECU', length=64))
    frames = [frame(0.01 * n, 7, bytes(60) + struct.pack("<HH", 1000 + n, 0)) for n in range(5)]
    path = logged(frames, tmp_path / f"log{kind}")
    content = (read_mf4 if kind == ".mf4" else read)(path, wanted("x", databases=[database]))
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
RANGES = "".join(f"SG_MUL_VAL_ 3 {each};\n" for each in SELECTED)


def test_a_multiplexer_says_which_frames_hold_a_signal(tmp_path, source):
    database = write_dbc(tmp_path / "mux.dbc", MUX, behind=RANGES)
    kind = truth(database).get_message_by_name("Mux")
    # Page 7 is not in the database: what does not hang on it is still good.
    pages = [(0, 40), (1, 5), (7, 5), (1, 6), (1, 4), (0, 41)]
    frames = [frame(n, 3, [page, low, 50 + n, 9, 0, 0, 0, n]) for n, (page, low) in enumerate(pages)]
    names = ("Low", "Also", "Inner", "Deep", "Always")
    channels = read_bus(frames, source, wanted(*names, databases=[database])).channels
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
        read_bus(frames, source, wanted("Never", databases=[database]))
    everything = read_bus(frames, source, wanted(databases=[database]))
    assert "Mux/Never" not in everything.channels
    assert "left out because no sample is valid: Mux/Never" in everything.notices


# --- J1939 ------------------------------------------------------------------------------------------------


def test_nodes_that_send_one_group_are_told_apart(j1939, source):
    asked = wanted("EEC1@0x00/EngSpeed", "EEC1@0x03/EngSpeed", databases=[j1939])
    for read_all in (asked, wanted(databases=[j1939])):
        channels = read_bus(senders(0, 3), source, read_all).channels
        for address in (0, 3):
            speed = channels[f"EEC1@{address:#04x}/EngSpeed"]
            np.testing.assert_array_equal(speed.values, 10 * address + np.arange(6))
            np.testing.assert_allclose(speed.clock_s, 0.01 * np.arange(6), rtol=EPS)
    for ambiguous in ("EngSpeed", "EEC1/EngSpeed"):
        nodes = "EEC1@0x00/EngSpeed, EEC1@0x03/EngSpeed"
        with pytest.raises(
            LogError, match=f"'{ambiguous}': several channels have this name; use the full name: {nodes}"
        ):
            read_bus(senders(0, 3), source, wanted(ambiguous, databases=[j1939]))
    with pytest.raises(LogError, match=r"'EEC1@0x05/EngSpeed': .*no such"):
        read_bus(senders(0, 3), source, wanted("EEC1@0x05/EngSpeed", databases=[j1939]))


@pytest.mark.parametrize(
    "name",
    ["EngSpeed", "EEC1/EngSpeed", "EEC1@0x03/EngSpeed", "EEC1@can1@0x03/EngSpeed", "EEC1@can1/EngSpeed"],
)
def test_one_node_may_be_named_or_not(j1939, source, name):
    content = read_bus(senders(3), source, wanted(name, databases=[j1939]))
    np.testing.assert_array_equal(content.channels[name].values, 30 + np.arange(6))
    assert list(read_bus(senders(3), source, wanted(databases=[j1939])).channels) == [
        "EEC1/Torque",
        "EEC1/EngSpeed",
    ]


def test_destination_and_priority_are_not_part_of_a_group_but_the_low_byte_of_a_broadcast_is(
    tmp_path, source
):
    # TSC1, group 0, goes to one node; 61443 and 61444 are two groups.
    tsc1, eec2 = EXTENDED | 0x0C0000FE, EXTENDED | 0x0CF003FE
    database = write_dbc(
        tmp_path / "j.dbc",
        *(message(each, f"G{n}", f'x{n} : 0|8@1+ (1,0) [0|0] "" ECU') for n, each in enumerate((tsc1, eec2))),
        behind=marked(tsc1, eec2),
    )
    ids = [0x0C000003, 0x0C000F03, 0x18000F03, 0x0CF00303, 0x0CF00403, 0x0D000003, 0x0C000003]
    frames = [frame(n, EXTENDED | each, [n] * 8) for n, each in enumerate(ids)]
    frames.append(frame(9, 0x003, [9] * 8))
    channels = read_bus(frames, source, wanted("x0", "x1", databases=[database])).channels
    np.testing.assert_array_equal(channels["x0"].values, [0, 1, 2, 6])
    np.testing.assert_array_equal(channels["x1"].values, [3])
    assert [parameter_group(each) for each in (0x0CF00401, 0x18EF1234)] == [61444, 0xEF00]


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


def test_what_is_not_available_is_left_out_of_its_own_signal_alone(j1939, source):
    raw = [0xFFFF, 800, 0xFE00, 0xFB00, 0xFAFF, 808]
    frames = [frame(0.1 * n, EXTENDED | 0x0CF00400, each) for n, each in enumerate(speeds(*raw))]
    content = read_bus(frames, source, wanted("EngSpeed", "Torque", databases=[j1939]))
    speed = content.channels["EngSpeed"]
    np.testing.assert_array_equal(speed.values, [100.0, 0xFAFF / 8, 101.0])
    np.testing.assert_allclose(speed.clock_s, [0.1, 0.4, 0.5], rtol=4 * EPS)
    assert content.channels["Torque"].values.size == 6
    assert content.notices == ("'EngSpeed': 3 of 6 samples are left out: not valid in J1939",)


def test_a_signal_that_is_never_available_is_an_error_only_where_it_is_asked_for(j1939, source):
    frames = [frame(0.1 * n, EXTENDED | 0x0CF00400, *speeds(0xFFFF)) for n in range(4)]
    with pytest.raises(LogError, match=r"'EngSpeed': .*4 samples.*'not available'"):
        read_bus(frames, source, wanted("EngSpeed", databases=[j1939]))
    content = read_bus(frames, source, wanted(databases=[j1939]))
    assert list(content.channels) == ["EEC1/Torque"]
    assert content.notices == ("left out because no sample is valid: EEC1/EngSpeed",)


def test_outside_j1939_all_ones_are_a_number(plain, source):
    read = read_bus([frame(0, 0x200, b"\xff" * 8)], source, wanted("Speed", databases=[plain]))
    np.testing.assert_array_equal(read.channels["Speed"].values, [255.0])


def test_ids_of_29_bits_are_met_exactly_where_nothing_says_j1939(tmp_path, source):
    own = EXTENDED | 0x18FF1000
    database = write_dbc(tmp_path / "own.dbc", message(own, "Own", 'x : 0|8@1+ (1,0) [0|0] "" ECU'))
    frames = [frame(n, EXTENDED | 0x18FF1000 | n % 2, [0xF0 + n] * 8) for n in range(6)]
    read = read_bus(frames, source, wanted("x", databases=[database]))
    np.testing.assert_array_equal(read.channels["x"].values, [0xF0, 0xF2, 0xF4])
    with pytest.raises(
        LogError,
        match=r"'x': the message 'Own' of this signal, id 0x18ff1000, .*PGN 65296 are in the log, from "
        r"source address 0x01.*J1939PG",
    ):
        read_bus(frames[1::2], source, wanted("x", databases=[database]))


def test_an_id_of_no_node_stands_for_all_unless_it_is_met(tmp_path, source):
    database = write_dbc(tmp_path / "null.dbc", message(EEC1, "EEC1", SPEED))
    content = read_bus(senders(0), source, wanted("EngSpeed", databases=[database]))
    np.testing.assert_array_equal(content.channels["EngSpeed"].values, np.arange(6))
    assert content.notices == (
        "'EEC1' was matched by its PGN 61444, from source address 0x00: "
        "the id in the DBC file, 0xcf004fe, has the null address",
    )
    content = read_bus(senders(0, 0xFE), source, wanted("EngSpeed", databases=[database]))
    np.testing.assert_array_equal(content.channels["EngSpeed"].values, 10 * 0xFE + np.arange(6))
    assert content.notices == ()
    database = write_dbc(tmp_path / "said.dbc", message(EEC1, "EEC1", SPEED), behind=marked())
    with pytest.raises(LogError, match="is not in the log"):
        read_bus(senders(0), source, wanted("EngSpeed", databases=[database]))


def test_a_whole_database_may_be_of_j1939(tmp_path, source):
    of_engine = EXTENDED | 0x0CF00400
    database = write_dbc(tmp_path / "all.dbc", message(of_engine, "EEC1", SPEED), behind=PROTOCOL)
    content = read_bus(senders(7), source, wanted("EngSpeed", databases=[database]))
    np.testing.assert_array_equal(content.channels["EngSpeed"].values, 70 + np.arange(6))
    assert content.notices == ()


def test_a_database_may_tell_nodes_apart_by_itself(tmp_path, source):
    first, second = EXTENDED | 0x0CF00400, EXTENDED | 0x0CF00403
    database = write_dbc(
        tmp_path / "two.dbc",
        message(first, "Engine", SPEED),
        message(second, "Gear", 'Half : 24|16@1+ (0.0625,0) [0|0] "rpm" ECU'),
        behind=marked(first, second),
    )
    channels = read_bus(senders(0, 3, 9), source, wanted(databases=[database])).channels
    assert list(channels) == ["Engine/EngSpeed", "Gear/Half"]
    np.testing.assert_array_equal(channels["Gear/Half"].values, (30 + np.arange(6)) / 2)


# --- buses, databases -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_buses_are_told_apart(tmp_path, plain, kind):
    frames = [frame(0.01 * n, 0x200, [10 * bus + n] * 8, bus=bus) for n in range(5) for bus in (1, 2)]
    path = logged([*frames, frame(0.06, 0x123, bytes(8))], tmp_path / f"log{kind}")
    reader = read_mf4 if kind == ".mf4" else read
    channels = reader(
        path, wanted("Other@can1/Speed", "Other@can2/Speed", "Count", databases=[plain])
    ).channels
    for bus in (1, 2):
        np.testing.assert_array_equal(channels[f"Other@can{bus}/Speed"].values, 10 * bus + np.arange(5))
    for ambiguous in ("Speed", "Other/Speed"):
        with pytest.raises(LogError, match="Other@can1/Speed, Other@can2/Speed"):
            reader(path, wanted(ambiguous, databases=[plain]))


def test_buses_and_nodes_are_told_apart_together(j1939, source):
    frames = [each._replace(bus=bus) for bus in (1, 2) for each in senders(0, 3)]
    names = set(read_bus(frames, source, wanted(databases=[j1939])).channels)
    assert {name for name in names if name.endswith("EngSpeed")} == {
        f"EEC1@can{bus}@{address}/EngSpeed" for bus in (1, 2) for address in ("0x00", "0x03")
    }
    with pytest.raises(LogError, match="EEC1@can1@0x00/EngSpeed, EEC1@can1@0x03"):
        read_bus(frames, source, wanted("EEC1@can1/EngSpeed", databases=[j1939]))


def test_what_is_asked_for_says_which_database_is_meant(tmp_path, source, plain):
    twice = write_dbc(tmp_path / "copy.dbc", *PLAIN)
    other = write_dbc(tmp_path / "b.dbc", message(0x200, "Else", 'Level : 0|8@1+ (2,0) [0|0] "" ECU'))
    unlike = write_dbc(tmp_path / "c.dbc", message(0x200, "Other", 'Speed : 0|8@1+ (3,0) [0|0] "" ECU'))
    frames = [frame(0, 0x200, [5] * 8)]
    channels = read_bus(frames, source, wanted("Speed", "Level", databases=[plain, twice, other])).channels
    assert [channels[name].values.tolist() for name in ("Speed", "Level")] == [[5.0], [10.0]]
    channels = read_bus(frames, source, wanted(databases=[plain, unlike])).channels
    assert {name: each.values.tolist() for name, each in channels.items()} == {
        "plain.Other/Speed": [5.0],
        "c.Other/Speed": [15.0],
    }


def test_a_database_that_changes_is_read_anew(tmp_path, source):
    for scale in (1, 3):
        signal = f'x : 0|8@1+ ({scale},0) [0|0] "" ECU'
        database = write_dbc(tmp_path / "a.dbc", message(1, "A", signal))
        read = read_bus([frame(0, 1, [7] * 8)], source, wanted("x", databases=[database]))
        assert read.channels["x"].values.tolist() == [7.0 * scale]


def test_signals_that_overlap_are_read_and_those_that_do_not_fit_are_left_out_with_a_notice(tmp_path, source):
    signals = [
        f'{name} : {place}|16@1+ (1,0) [0|0] "" ECU' for name, place in zip("xyz", (0, 8, 56), strict=True)
    ]
    database = write_dbc(tmp_path / "bad.dbc", message(1, "A", *signals))
    content = read_bus([frame(0, 1, [1, 2, 3, 4, 5, 6, 7, 8])], source, wanted(databases=[database]))
    assert {name: each.values.tolist() for name, each in content.channels.items()} == {
        "A/x": [0x0201],
        "A/y": [0x0302],
    }
    assert content.notices[0].startswith("bad.dbc: read with errors (")


def test_a_signal_of_more_than_64_bits_is_no_number(tmp_path, source):
    wide, narrow = 'wide : 0|72@1+ (1,0) [0|0] "" ECU', 'x : 80|8@1+ (1,0) [0|0] "" ECU'
    database = write_dbc(tmp_path / "a.dbc", message(1, "A", wide, narrow, length=12))
    read = read_bus([frame(0, 1, range(12))], source, wanted(databases=[database]))
    assert {name: each.values.tolist() for name, each in read.channels.items()} == {"A/x": [10.0]}


# --- what is left out, what is refused --------------------------------------------------------------------


@pytest.mark.parametrize("kind", ALL_FRAMES)
def test_error_frames_and_short_frames_are_counted(tmp_path, plain, kind):
    frames = [frame(0.01 * n, 0x123, bytes([n] * 8)) for n in range(5)]
    frames[2] = frames[2]._replace(data=bytes(5))
    frames.insert(1, Frame(0.005, 1, 0, True, None))
    path = logged(frames, tmp_path / f"log{kind}")
    content = (read_mf4 if kind == ".mf4" else read)(path, wanted("Count", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Count"].values, [0, 1, 3, 4])
    assert content.notices == (
        "1 error and remote frames are left out",
        "'Hitch': 1 of 5 frames are left out: shorter than 8 bytes",
    )


def test_remote_frames_are_no_data(tmp_path, plain):
    with can.BLFWriter(tmp_path / "log.blf") as log:
        log(
            can.Message(
                timestamp=1.0, arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=8
            )
        )
        log(can.Message(timestamp=2.0, arbitration_id=0x123, is_extended_id=False, data=bytes(8)))
    content = read(tmp_path / "log.blf", wanted("Count", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Count"].clock_s, [0.0])
    assert content.notices == ("1 error and remote frames are left out",)


def test_a_message_whose_frames_are_all_short_is_refused(plain, source):
    with pytest.raises(LogError, match=r"'Count': .*8 bytes"):
        read_bus([frame(0, 0x123, bytes(7))], source, wanted("Count", databases=[plain]))


def test_a_log_without_a_database_says_what_is_required(source):
    with pytest.raises(
        LogError, match=r"log\.asc: a DBC file is required: put it in the log's folder or name it in camp"
    ):
        read_bus([], source, wanted("x"))


def test_a_log_without_frames_or_without_known_ones_is_refused(plain, source):
    with pytest.raises(LogError, match="holds no CAN frames with data"):
        read_bus([Frame(0.0, 1, 0, False, None)], source, wanted(databases=[plain]))
    with pytest.raises(LogError, match="1 frames"):
        read_bus([frame(0, 0x7FF, bytes(8))], source, wanted(databases=[plain]))
    with pytest.raises(
        LogError, match=r"'Count': the message 'Hitch' of this signal, id 0x123, is not in the log$"
    ):
        read_bus([frame(0, 0x7FF, bytes(8))], source, wanted("Count", databases=[plain]))
    with pytest.raises(LogError, match=r"'Nothing': .*Other/Speed"):
        read_bus([frame(0, 0x200, bytes(8))], source, wanted("Nothing", databases=[plain]))


DAMAGED = {
    "empty": b"",
    "noise": bytes(range(256)) * 4,
    "words": b"BO_ 1 A: 8 X\n SG_ x : nonsense",
    "no signals": b'VERSION ""\n',
    "an id of 30 bits": b'VERSION ""\nBU_: X\nBO_ 4294967295 A: 8 X\n SG_ x : 0|8@1+ (1,0) [0|0] "" X\n',
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED.keys())
def test_a_damaged_database_is_refused_by_its_name(tmp_path, source, content):
    (tmp_path / "bad.dbc").write_bytes(content)
    with pytest.raises(LogError, match=r"bad\.dbc: "):
        read_bus([frame(0, 1, bytes(8))], source, wanted(databases=[tmp_path / "bad.dbc"]))


def test_a_database_cut_short_anywhere_gives_a_log_error_or_numbers(tmp_path, source, plain):
    whole, cut = plain.read_bytes(), tmp_path / "cut.dbc"
    refused = 0
    for size in range(0, len(whole), 17):
        cut.write_bytes(whole[:size])
        try:
            read_bus([frame(0, 0x123, bytes(8))], source, wanted("Position", databases=[cut]))
        except LogError:
            refused += 1
    assert refused > 5


def test_a_database_that_is_not_there_is_refused(tmp_path, source):
    with pytest.raises(LogError, match=r"none\.dbc: cannot be read"):
        read_bus([], source, wanted(databases=[tmp_path / "none.dbc"]))


@pytest.mark.parametrize(
    ("module", "reader", "extra"),
    [("can", read, "can"), ("cantools", read, "can"), ("asammdf", read_mf4, "mdf")],
)
def test_a_missing_library_is_named_with_the_extra_that_brings_it(
    tmp_path, plain, monkeypatch, module, reader, extra
):
    path = logged([frame(0, 0x200, bytes(8))], tmp_path / "log.asc")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(LogError, match=rf"log\.asc: .* is required .*pip install 'hitchid\[{extra}\]'"):
        reader(path, wanted(databases=[plain]))


@pytest.mark.parametrize("kind", [*SUFFIXES, ".mf4"])
@pytest.mark.parametrize(
    "content", [b"", b"x", b"LOGG", b"\0" * 400, bytes(range(256)) * 8, b"time,x\n0,1\n" * 50]
)
def test_what_is_no_log_is_refused(tmp_path, plain, kind, content):
    path = tmp_path / f"log{kind}"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"log\."):
        (read_mf4 if kind == ".mf4" else read)(path, wanted(databases=[plain]))


@pytest.mark.parametrize("kind", [*SUFFIXES, ".mf4"])
def test_what_is_no_file_is_refused(tmp_path, plain, kind):
    (tmp_path / f"folder{kind}").mkdir()
    for name in ("folder", "missing"):
        with pytest.raises(LogError, match="cannot be read"):
            (read_mf4 if kind == ".mf4" else read)(tmp_path / f"{name}{kind}", wanted(databases=[plain]))


# --- logs that were cut short, by format ------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"compression_level": 0}, {"max_container_size": 500}])
def test_a_blf_log_cut_anywhere_is_refused(tmp_path, plain, options):
    path = tmp_path / "log.blf"
    with can.BLFWriter(path, **options) as log:
        for n in range(60):
            log(can.Message(timestamp=0.01 * n, arbitration_id=0x200, is_extended_id=False, data=[n] * 8))
    whole = path.read_bytes()
    assert read(path, wanted("Speed", databases=[plain])).channels["Speed"].values.size == 60
    for size in range(0, len(whole), 7):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"log\.blf: "):
            read(path, wanted("Speed", databases=[plain]))


@pytest.mark.parametrize("options", [{}, {"compression_level": 0}, {"max_container_size": 500}])
def test_a_blf_log_that_was_never_closed_is_refused_where_an_object_is_cut_else_noticed(
    tmp_path, plain, options
):
    path = tmp_path / "log.blf"
    with can.BLFWriter(path, **options) as log:
        for n in range(60):
            log(can.Message(timestamp=0.01 * n, arbitration_id=0x200, is_extended_id=False, data=[n] * 8))
    # Size of file and count of objects as they stand until the log is closed.
    whole = bytearray(path.read_bytes())
    whole[16:36] = struct.pack("<QQL", 144, 144, 0)
    read_whole = 0
    for size in (*range(144, len(whole), 5), *range(len(whole) - 50, len(whole) + 1)):
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


def test_a_blf_log_with_any_byte_damaged_is_refused_or_gives_all_frames(tmp_path, plain):
    path = logged([frame(0.01 * n, 0x200, [n] * 8) for n in range(60)], tmp_path / "log.blf")
    whole = path.read_bytes()
    refused = 0
    for at in range(144, len(whole), 2):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            values = read(path, wanted("Speed", databases=[plain])).channels["Speed"].values
        except LogError:
            refused += 1
        else:
            np.testing.assert_array_equal(values, np.arange(60))
    assert refused > (len(whole) - 144) // 4


def test_an_asc_log_cut_anywhere_gives_no_false_number(tmp_path, plain):
    path = logged([frame(0.01 * n, 0x200, [0xA0 + n] * 8) for n in range(30)], tmp_path / "log.asc")
    whole = path.read_bytes()
    end = whole.index(b"End TriggerBlock")
    for size in [*range(0, end, 13), *range(end - 60, end + 4)]:
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


@pytest.mark.parametrize("kind", [".asc.gz", ".mf4"])
def test_a_compressed_text_log_or_an_mf4_log_cut_anywhere_is_refused(tmp_path, plain, kind):
    frames = [frame(0.01 * n, 0x200, [n] * 8) for n in range(60)]
    path = logged(frames, tmp_path / f"log{kind.removesuffix('.gz')}")
    whole = path.read_bytes() if kind == ".mf4" else gzip.compress(path.read_bytes())
    path = tmp_path / f"log{kind}"
    for size in range(0, len(whole), len(whole) // 60):
        path.write_bytes(whole[:size])
        with pytest.raises(LogError, match=r"log\."):
            (read_mf4 if kind == ".mf4" else read)(path, wanted("Speed", databases=[plain]))


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


def test_a_line_that_cannot_be_read_is_named(tmp_path, plain):
    (tmp_path / "log.asc").write_text(HEADER + LINES.replace("03 00", "0g 00"))
    with pytest.raises(LogError, match=r"log\.asc: line 6: .*CAN"):
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


def test_a_text_that_ends_in_log_is_a_log_only_if_candump_wrote_it(tmp_path):
    (tmp_path / "server.log").write_text("2026-11-21 12:00:00 started\n" * 30)
    (tmp_path / "bus.log").write_text(CANDUMPS["log file"].replace("{n}", "1"))
    assert known_format(tmp_path / "server.log") is None
    assert known_format(tmp_path / "bus.log") is not None


def test_relative_stamps_are_refused(tmp_path, plain):
    (tmp_path / "log.asc").write_text(HEADER.replace("absolute", "relative") + LINES)
    with pytest.raises(
        LogError, match="relative to the previous line; expected 'base hex timestamps absolute'"
    ):
        read(tmp_path / "log.asc", wanted("Speed", databases=[plain]))


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
    channel = read_mf4(tmp_path / "log.mf4", wanted("Speed", databases=[plain])).channels["Speed"]
    np.testing.assert_array_equal(channel.values, np.arange(6))
    np.testing.assert_array_equal(channel.clock_s, np.arange(6))


def test_a_bus_log_may_hold_its_fields_as_channels_of_their_own(tmp_path, plain):
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
        log.append([Signal(each, stamps, name=f"CAN_DataFrame.{name}") for name, each in fields.items()])
        log.save(tmp_path / "log.mf4")
    assert is_bus_log(tmp_path / "log.mf4")
    content = read_mf4(tmp_path / "log.mf4", wanted("Other@can2/Speed", databases=[plain]))
    np.testing.assert_array_equal(content.channels["Other@can2/Speed"].values, [0, 1, 3, 4, 5])
    assert content.notices == ("'Other': 1 of 6 frames are left out: shorter than 8 bytes",)
