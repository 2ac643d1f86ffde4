"""Sources: what arrives is a sample, all else is left out, and commands go where they belong."""

import contextlib
import json
import os
import socket
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benches import write_bench
from hitchid.errors import InputError
from hitchid.hmi.bench_loop import BenchLoop
from hitchid.hmi.safety import State
from hitchid.hmi.source import Source
from hitchid.hmi.sources import make_source
from hitchid.hmi.sources.json_lines import MOST_BYTES, JsonLines, UdpTransport
from hitchid.logs import read

STEP_S = 0.01


class FakeTransport:
    """A transport that gives some pieces, and keeps what is sent."""

    def __init__(self, *pieces):
        self.pieces, self.sent = list(pieces), []

    def open(self):
        pass

    def read(self):
        return self.pieces.pop(0) if self.pieces else None

    def write(self, line):
        self.sent.append(line)

    def close(self):
        pass


def line(k, displacement=100.0):
    return json.dumps({"time_s": STEP_S * k, "lifting_command": 0.5, "displacement": displacement}).encode()


def opened(*pieces, **options):
    source = JsonLines(FakeTransport(*pieces), "lines", **options)
    source.open()
    return source


@contextlib.contextmanager
def connected(text):
    """Yield the source of a text while it is open."""
    source = make_source(text)
    source.open()
    try:
        yield source
    finally:
        source.close()


def times(readings):
    return [round(reading.time_s / STEP_S) for reading in readings]


def until(source, count, longest_s=5.0):
    """Read until so many samples have arrived."""
    readings, end_s = [], time.monotonic() + longest_s
    while len(readings) < count and time.monotonic() < end_s:
        readings += source.read()
        time.sleep(0.001)
    return readings


@given(st.lists(st.integers(1, 60), max_size=40))
def test_lines_are_whole_however_they_arrive_cut(sizes):
    data = b"".join(line(k) + b"\n" for k in range(20))
    cuts = np.cumsum(sizes)
    pieces = [bytes(piece) for piece in np.split(np.frombuffer(data, np.uint8), cuts[cuts < len(data)])]
    source = opened(*pieces)
    readings = [reading for _ in pieces for reading in source.read()]
    assert times(readings) == list(range(20))
    assert readings[0].values[0] == 0.5
    assert np.isnan(readings[0].values[1])
    assert readings[0].values[2] == 100.0


@pytest.mark.parametrize(
    "junk",
    [
        b"",
        b"nonsense",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"displacement": 1}',
        b'{"time_s": "now"}',
        b'{"time_s": NaN}',
        b'{"time_s": Infinity}',
        b'{"time_s": 1e999}',
        b'{"time_s": 0.0}',
        b'{"time_s": true}',
        b"[" * 5000,
        b'{"time_s": ' + b"1" * 5000 + b"}",
    ],
)
def test_what_is_no_sample_is_left_out(junk):
    source = opened(line(0) + b"\n" + junk + b"\n" + line(1) + b"\n")
    assert times(source.read()) == [0, 1]


@pytest.mark.parametrize("value", ["high", None, [1], True, float("inf"), float("nan")])
def test_a_value_that_is_no_number_is_missing(value):
    assert np.isnan(opened(line(0, value) + b"\n").read()[0].values[2])


def test_samples_out_of_order_are_left_out():
    source = opened(b"\n".join(line(k) for k in (0, 1, 1, 0, 2)) + b"\n")
    assert times(source.read()) == [0, 1, 2]
    with pytest.raises(InputError, match="lines: the input has ended; connect again"):
        source.read()


def test_a_line_without_end_costs_bounded_memory():
    source = opened(*[b"x" * MOST_BYTES] * 20, b"\n" + line(0) + b"\n")
    for _ in range(20):
        assert source.read() == ()
    assert len(source._pending) <= MOST_BYTES
    assert times(source.read()) == [0]


@pytest.mark.parametrize("can_move", [False, True])
def test_commands_are_sent_only_where_they_are_taken(can_move):
    source = opened(b"", can_move=can_move)
    source.write(np.array([0.5, 0.0]))
    sent = list(map(json.loads, source._transport.sent))
    assert sent == [{"lifting_command": 0.5, "lowering_command": 0.0}] * can_move


def test_a_serial_device_is_read_and_written_without_waiting():
    with pytest.raises(InputError, match=r"/dev/nothing-here: cannot be opened: .*expected a device"):
        make_source("serial:/dev/nothing-here").open()
    device, end = os.openpty()
    try:
        with connected(f"serial:{os.ttyname(end)}") as source:
            assert (source.can_move, source.virtual) == (True, False)
            assert source.read() == ()
            os.write(device, line(0) + b"\n" + line(1)[:7])
            assert times(until(source, 1)) == [0]
            os.write(device, line(1)[7:] + b"\n")
            assert times(until(source, 1)) == [1]
            source.write(np.array([0.25, 0.0]))
            assert json.loads(os.read(device, 1000)) == {"lifting_command": 0.25, "lowering_command": 0.0}
            os.close(end)
            os.close(device)
            with pytest.raises(InputError, match="the input has ended"):
                until(source, 1)
    finally:
        for descriptor in (device, end):
            with contextlib.suppress(OSError):
                os.close(descriptor)


@pytest.fixture
def udp():
    """Return a source at a free port, and a socket that talks to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with connected(f"udp:{port}") as source, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.connect(("127.0.0.1", port))
        peer.settimeout(5.0)
        yield source, peer


def test_datagrams_are_samples_and_answered_to_their_sender(udp):
    source, peer = udp
    source.write(np.array([0.5, 0.0]))  # to nobody yet
    assert source.read() == ()
    peer.send(line(0))
    assert times(until(source, 1)) == [0]
    source.write(np.array([0.0, 0.5]))
    assert json.loads(peer.recv(1000)) == {"lifting_command": 0.0, "lowering_command": 0.5}


def test_a_sender_faster_than_the_loop_is_not_read_late(udp):
    source, peer = udp
    for k in range(100):
        peer.send(line(k))
    time.sleep(0.05)
    assert times(source.read()) == list(range(100))


def test_a_flood_of_datagrams_ends_each_read(udp):
    source, peer = udp
    for _ in range(50):
        peer.send(b"x" * 9000)
    begin_s = time.monotonic()
    source.read()
    assert time.monotonic() - begin_s < 0.5


def test_a_port_is_of_one_source_on_this_machine(udp):
    transport = udp[0]._transport
    assert transport._socket.getsockname()[0] == "127.0.0.1"
    with pytest.raises(InputError, match="choose a free port"):
        UdpTransport(transport._port).open()


def test_standard_input_is_read_and_not_written(monkeypatch):
    incoming, outgoing = os.pipe()
    with os.fdopen(incoming) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        with connected("stdin") as source:
            assert not source.can_move
            assert source.read() == ()
            os.write(outgoing, line(0) + b"\n")
            assert times(until(source, 1)) == [0]
            source._transport.write(b"nothing")
            os.close(outgoing)
            with pytest.raises(InputError, match="the input has ended"):
                until(source, 1)


def test_a_replay_gives_the_samples_of_the_log_and_ends(bench_folder):
    log = next(bench_folder.glob("*.csv"))
    record = read(str(log)).records[0]
    with connected(f"replay:{log}") as source:
        assert isinstance(source, Source)
        readings = [source.read()[0] for _ in range(len(record))]
        times_s, values = [reading.time_s for reading in readings], np.array([own.values for own in readings])
        np.testing.assert_array_equal(values[:, 2], record.displacement)
        np.testing.assert_allclose(times_s, record.step_s * np.arange(len(record)), atol=1e-9)
        for channel, direction in enumerate(("lifting", "lowering")):
            given = record.command(direction) if direction in record.directions else np.zeros(len(record))
            np.testing.assert_array_equal(values[:, channel], given)
        assert (source.virtual, source.can_move, source.step_s) == (True, False, record.step_s)
        with pytest.raises(InputError, match="the log has ended; connect again"):
            source.read()
        source.open()
        assert source.read()[0] == readings[0]


def test_a_replay_through_the_bench_loop_moves_nothing_and_ends(tmp_path):
    (tmp_path / "campaigns").mkdir()
    folder = write_bench(tmp_path / "campaigns" / "a", tests=2, samples=60)
    (folder / "wrong.csv").write_text("nonsense\n")
    log = next(folder.glob("lifting*.csv"))
    loop, request = BenchLoop(tmp_path), {"type": "connect", "source": "replay"}
    with pytest.raises(InputError, match=r"wrong\.csv"):
        loop.handle({**request, "options": {"log": "campaigns/a/wrong.csv"}}, 0.0)
    loop.handle({**request, "options": {"log": f"campaigns/a/{log.name}"}}, 0.0)
    loop.tick(0.0)
    with pytest.raises(InputError, match="takes no commands"):
        loop.handle({"type": "arm", "plan": {"kind": "campaign", "name": "b"}}, 0.0)
    count = 1
    while loop.state is State.IDLE and count < 10_000:
        count += len(loop.tick(0.0))
    assert loop.state is State.DISCONNECTED
    assert "the log has ended" in loop.describe()["reason"]
    assert count == len(read(str(log)).records[0])


DBC = """\
VERSION ""
NS_ :
BS_:
BU_: ECU HMI
BO_ 256 Position: 8 ECU
 SG_ Hitch : 0|16@1+ (0.01,0) [0|655.35] "mm" HMI
 SG_ Pressure : 16|16@1+ (0.1,0) [0|6553.5] "bar" HMI
BO_ 257 Currents: 8 ECU
 SG_ Up : 0|16@1+ (0.001,0) [0|65.535] "A" HMI
 SG_ Down : 16|16@1+ (0.001,0) [0|65.535] "A" HMI
BO_ 512 Command: 8 HMI
 SG_ Lift : 0|16@1+ (0.001,0) [0|65.535] "A" ECU
 SG_ Lower : 16|16@1+ (0.001,0) [0|65.535] "A" ECU
"""
BUS = """\
interface = "virtual"
channel = "hitchid-test"
database = "hitch.dbc"
[signals]
lifting_command = "Currents/Up"
lowering_command = "Currents/Down"
displacement = "Position/Hitch"
cylinder_pressure = "Position/Pressure"
"""
OUTPUT = """\
[output]
message = "Command"
lifting_command = "Lift"
lowering_command = "Lower"
"""


@pytest.fixture
def can_file(tmp_path):
    pytest.importorskip("can")
    pytest.importorskip("cantools")
    (tmp_path / "hitch.dbc").write_text(DBC)
    (tmp_path / "bus.toml").write_text(BUS + OUTPUT)
    return tmp_path / "bus.toml"


@pytest.fixture
def can_bus(can_file):
    """Return a source on a virtual bus, and a bus that talks to it."""
    import can

    with (
        connected(f"can:{can_file}") as source,
        can.Bus(interface="virtual", channel="hitchid-test") as peer,
    ):
        yield source, peer


def frame(number, *words):
    import can

    data = b"".join(word.to_bytes(2, "little") for word in words).ljust(8, b"\0")
    return can.Message(arbitration_id=number, data=data, is_extended_id=False)


def test_the_newest_values_on_a_bus_are_a_sample(can_bus, monkeypatch):
    source, peer = can_bus
    assert np.isnan(source.read()[0].values).all()
    for hitch in (10_000, 12_345):
        peer.send(frame(256, hitch, 1805))
    peer.send(frame(257, 500, 0))
    peer.send(frame(0x7FF, 1, 1))
    now_s = time.monotonic()
    assert source.read()[0].values == pytest.approx((0.5, 0.0, 123.45, 180.5))
    assert [signal.unit for signal in source.signals] == ["A", "A", "mm", "bar"]
    monkeypatch.setattr("hitchid.hmi.sources.can_bus.time.monotonic", lambda: now_s + 1.0)
    assert np.isnan(source.read()[0].values).all()


def test_commands_are_sent_as_the_database_says_if_it_does(can_bus, can_file):
    source, peer = can_bus
    source.write(np.array([0.75, 0.0]))
    sent = peer.recv(timeout=2.0)
    assert (sent.arbitration_id, bytes(sent.data[:4])) == (512, (750).to_bytes(2, "little") + b"\0\0")
    can_file.write_text(BUS)
    with connected(f"can:{can_file}") as silent:
        silent.write(np.array([0.5, 0.0]))
        assert not silent.can_move
        assert peer.recv(timeout=0.05) is None


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("Position/Hitch", "Position/Height", "'Position/Height' is not in the database"),
        ("Position/Hitch", "Hitch", "is not in the database"),
        ('displacement = "Position/Hitch"\n', "", "signals lacks displacement"),
        ("hitch.dbc", "none.dbc", "cannot be read"),
        ('channel = "hitchid-test"\n', "", "channel"),
        ('message = "Command"', 'message = "Order"', "Order"),
        ('lifting_command = "Lift"', 'lifting_command = "Raise"', "Raise"),
        ('interface = "virtual"', 'interface = "virtual"\nstep_s = 0', "step_s"),
        ('interface = "virtual"', 'interface = "nothing"', "cannot be opened"),
    ],
)
def test_a_wrong_bus_file_is_refused_before_anything_is_sent(can_file, old, new, problem):
    can_file.write_text(can_file.read_text().replace(old, new))
    with pytest.raises(InputError, match=problem):
        make_source(f"can:{can_file}").open()


def test_a_frame_that_cannot_be_decoded_is_a_missing_value(can_bus):
    import can

    source, peer = can_bus
    peer.send(can.Message(arbitration_id=256, data=b"\x01", is_extended_id=False))
    peer.send(can.Message(arbitration_id=256, is_remote_frame=True, dlc=8, is_extended_id=False))
    peer.send(frame(257, 500, 0))
    values = source.read()[0].values
    assert np.isnan(values[2])
    assert values[0] == pytest.approx(0.5)


def test_a_flood_of_datagrams_from_strangers_holds_up_no_tick():
    class Flood:
        def recvfrom(self, _):
            return b"x", ("127.0.0.1", 2)

    transport = UdpTransport(5005)
    transport._sender, transport._socket = ("127.0.0.1", 1), Flood()
    assert transport.read() == b""
