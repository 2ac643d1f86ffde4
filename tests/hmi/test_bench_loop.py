"""The bench loop: only a run moves anything, and whatever goes wrong closes the valves and stays so."""

import csv
import errno
import json
import os
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fake_bench
from fake_bench import STEP_S, Machine, Plant
from hitchid.errors import InputError
from hitchid.hmi import bench_loop, connected_source, disk, recorder
from hitchid.hmi.bench_loop import LATEST_S, BenchLoop
from hitchid.hmi.programs import Step
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.safety import State

CLOSED = (0.0, 0.0)
WITHIN = {"kind": "campaign", "name": "monday", "ramps": 1, "ramp_s": 5, "tests": 1, "test_s": 3}


def rows_of(path):
    with path.open() as file:
        header, *rows = csv.reader(file)
    return header, np.array([[float(cell or "nan") for cell in row] for row in rows])


def assert_closed(bench, *, ticks=20):
    """Nothing but zero is sent in further ticks, and the state stays stopped."""
    sent = len(bench.plant.sent)
    bench.tick(ticks)
    assert bench.state is State.STOPPED
    assert set(bench.plant.sent[sent:]) <= {CLOSED}
    assert not bench.loop.commands.any()


def open_logs(folder):
    """Return the logs below a folder that this process holds open."""
    held = {os.path.realpath(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")}
    return {path for path in held if path.startswith(str(folder)) and path.endswith(".csv")}


def test_a_bench_that_is_connected_or_armed_sends_zero(make_bench, write_test):
    bench = make_bench()
    readings = bench.tick(50)
    assert bench.plant.sent == [CLOSED] * 50
    assert [reading.time_s for reading in readings] == [STEP_S * k for k in range(50)]
    assert readings[0].values == (0.0, 0.0, 100.0)
    bench.ask("arm", plan=write_test())
    bench.tick(100)
    assert bench.state is State.ARMED
    assert set(bench.plant.sent) == {CLOSED}


def test_a_run_sends_the_commands_of_its_file_then_zero(make_bench, write_test, tmp_path):
    bench = make_bench()
    bench.run(**write_test(lifting=0.6, duration_s=0.5))
    bench.tick(100)
    assert bench.plant.sent == [CLOSED] + 51 * [(0.6, 0.0)] + 49 * [CLOSED]
    assert bench.state is State.IDLE
    header, rows = rows_of(tmp_path / "campaigns" / "next" / "next.csv")
    assert len(rows) == 51
    assert header[0] == "time_s"


def test_the_command_of_a_row_acts_until_the_next(make_bench, write_test, tmp_path):
    bench = make_bench(Plant(dead_zones=(0.0, 0.0)))
    plan = write_test()
    times = 0.03 * np.arange(60)
    levels = np.random.default_rng(0).uniform(0.0, 0.5, 60)
    rows = "".join(f"{time:.2f},{level:.3f},0\n" for time, level in zip(times, levels, strict=True))
    (tmp_path / plan["file"]).write_text(f"time_s,lifting_command,lowering_command\n{rows}")
    bench.run(**plan)
    bench.tick(250)
    _, log = rows_of(tmp_path / "campaigns" / "next" / "next.csv")
    time_s, lifting, _, displacement = log.T
    np.testing.assert_allclose(np.diff(time_s), STEP_S, atol=1e-9)
    # Ten significant digits are written: 1e-7 mm of a displacement of a few hundred.
    np.testing.assert_allclose(np.diff(displacement), STEP_S * 100.0 * lifting[:-1], atol=2e-7)


@given(st.lists(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 2), min_size=1, max_size=20))
def test_whatever_a_program_asks_for_is_sent_within_limits(wanted):
    plant = Plant()
    with pytest.MonkeyPatch.context() as patch:
        bench = bench_with(patch, plant, [np.array(pair) for pair in wanted])
        bench.tick(len(wanted) + 5)
    for lifting, lowering in plant.sent:
        assert 0.0 <= lifting <= 0.9
        assert 0.0 <= lowering <= 0.8
        assert lifting == 0 or lowering == 0


def bench_with(patch, plant, commands):
    """Return a bench whose run asks for given commands, or raises one that is an error; nothing is logged."""

    class Asked:
        step, plan, displacement, has_folder = Step(np.zeros(2), "test"), None, 100.0, True

        def __init__(self, *_):
            self.target, self._rest = None, list(commands)

        def begin(self):
            pass

        def advance(self, _):
            if not self._rest:
                return False
            wanted = self._rest.pop(0)
            if isinstance(wanted, Exception):
                raise wanted
            self.step = Step(wanted, "test")
            return True

        def record(self, readings):
            pass

        def end(self):
            pass

    patch.setattr(fake_bench, "made", lambda: plant, raising=False)
    patch.setattr(bench_loop, "Run", Asked)
    patch.setattr(connected_source, "read_limits", lambda _: fake_bench.LIMITS)
    bench = fake_bench.Bench(BenchLoop(Path("/nonexistent"), limits_file=Path("limits.toml")), plant)
    bench.ask("connect", source="fake_bench:made")
    bench.run(**WITHIN)
    return bench


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        (np.array([0.5, 0.5]), "both valves"),
        (np.array([0.5, 1e-9]), "both valves"),
        (InputError("no more"), "^no more$"),
        (ZeroDivisionError("by zero"), "^ZeroDivisionError: by zero$"),
        (np.zeros(3), "shape|broadcast"),
    ],
)
def test_a_program_that_errs_closes_the_valves_at_once(monkeypatch, wanted, reason):
    plant = Plant()
    bench = bench_with(monkeypatch, plant, [np.array([0.6, 0.0])] * 3 + [wanted] + [np.array([0.6, 0.0])] * 9)
    bench.tick(4)
    assert plant.sent == [CLOSED] + 3 * [(0.6, 0.0)] + [CLOSED]
    assert re.search(reason, bench.reason)
    assert_closed(bench)


@pytest.mark.parametrize("who", ["server", "page"])
def test_half_a_second_without_a_sign_of_life_latches(running, who):
    begun = len(running.plant.sent)
    running.tick(60, **{who: False})
    moved = sum(sent != CLOSED for sent in running.plant.sent[begun:])
    assert 49 <= moved <= 50
    assert who in running.reason
    assert_closed(running, ticks=100)


def test_an_armed_bench_whose_page_is_gone_is_stopped(armed):
    armed.tick(60, page=False)
    assert_closed(armed)
    with pytest.raises(InputError, match="reset"):
        armed.ask("start")


def test_a_stop_takes_effect_at_once_and_closes_the_log(running, tmp_path, monkeypatch):
    sent, sent_at_close, close = running.plant.sent, [], Recorder.close
    assert sent[-1] == (0.6, 0.0)
    monkeypatch.setattr(Recorder, "close", lambda self: (sent_at_close.append(sent[-1]), close(self)))
    before = len(sent)
    running.ask("stop", reason="operator")
    assert sent_at_close == []
    running.tick()
    assert sent[before:] == sent_at_close == [CLOSED]
    assert running.reason == "operator"
    assert len(rows_of(tmp_path / "campaigns" / "next" / "next.csv")[1]) == 20
    assert_closed(running)
    assert not running.loop.describe()["run"]


def test_after_a_stop_only_reset_arm_and_start_move_again(running, write_test):
    plan = {**write_test(), "name": "again"}
    running.ask("stop")
    for kind in ("start", "connect", "arm"):
        with pytest.raises(InputError, match="reset"):
            running.ask(kind, plan=plan, source="fake_bench:made")
    running.ask("reset")
    running.tick(5)
    assert set(running.plant.sent[-5:]) == {CLOSED}
    running.run(**plan)
    running.tick()
    assert running.plant.sent[-1] == (0.6, 0.0)


def test_a_silent_sensor_stops_within_its_limit(running):
    running.plant.is_silent = True
    sent = len(running.plant.sent)
    running.tick(20)
    moved = sum(commands != CLOSED for commands in running.plant.sent[sent:])
    assert moved <= 0.05 / STEP_S
    assert "no displacement" in running.reason
    assert_closed(running)


def test_a_displacement_outside_the_limits_stops_in_its_sample(running):
    running.plant.displacement = 256.0  # the margin is 2 % of 250 mm
    running.tick()
    assert running.plant.sent[-1] == CLOSED
    assert "256 is outside 0 to 250" in running.reason
    assert_closed(running)


def test_a_lost_source_is_sent_zero_closed_and_latched(running, tmp_path):
    running.plant.is_lost = True
    running.tick()
    assert running.plant.sent[-1] == CLOSED
    assert not running.plant.is_open
    assert (running.state, running.reason) == (State.STOPPED, "the plug was pulled")
    assert len(rows_of(tmp_path / "campaigns" / "next" / "next.csv")[1]) == 20
    running.ask("reset")
    assert running.state is State.DISCONNECTED


@pytest.mark.parametrize("end", [lambda bench: bench.ask("disconnect"), lambda bench: bench.loop.close()])
def test_zero_is_the_last_command_before_a_source_is_closed(running, end):
    end(running)
    assert running.plant.sent[-2:] == [(0.6, 0.0), CLOSED]
    assert not running.plant.is_open
    assert running.state is State.STOPPED


@pytest.mark.parametrize("raised", [InputError("bus off"), OSError("gone"), ZeroDivisionError("driver")])
@pytest.mark.parametrize("call", ["read", "write"])
def test_of_a_source_that_raises_the_loop_goes_on(running, monkeypatch, call, raised):
    def fail(*_):
        raise raised

    monkeypatch.setattr(running.plant, call, fail)
    running.tick(5)
    assert running.state is State.STOPPED
    assert str(raised) in running.reason
    assert ("zero could not be sent" in running.reason) == (call == "write")
    assert not running.plant.is_open


def test_a_sample_that_lacks_a_value_loses_the_source(make_bench, monkeypatch):
    bench = make_bench()
    monkeypatch.setattr(bench.plant, "read", lambda: [bench_loop.Reading(0.0, (0.0, 0.0))])
    bench.tick()
    assert "a value for each signal" in bench.reason
    assert bench.state is State.DISCONNECTED


def full_disk(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_stops_the_run_and_closes_its_logs(make_bench, write_test, monkeypatch, tmp_path):
    bench = make_bench()
    bench.tick()
    bench.ask("record", on=True)
    bench.run(**write_test())
    bench.tick(40)
    assert len(open_logs(tmp_path)) == 2
    monkeypatch.setattr(recorder.os, "write", full_disk)
    bench.tick(25)  # FLUSH_S later something was written
    monkeypatch.undo()
    assert bench.plant.sent[-1] == CLOSED
    assert "No space left on device" in bench.reason
    assert_closed(bench)
    assert bench.loop.describe()["recording"] is None
    end_s = time.monotonic() + 10.0
    while open_logs(tmp_path):
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.parametrize("frozen", ["mkdir", "open", "write"])
def test_a_frozen_disk_ends_the_run_without_a_wait(make_bench, write_test, monkeypatch, frozen):
    plan, now_s, thawed = write_test(), [0.0], threading.Event()
    monkeypatch.setattr(disk.time, "monotonic", lambda: now_s[0])
    frozen_call = getattr(os, frozen)
    monkeypatch.setattr(os, frozen, lambda *given, **named: thawed.wait(60) and frozen_call(*given, **named))
    try:
        bench = make_bench(disk=disk.Disk())
        bench.run(**plan)
        bench.tick(100)  # none of which would return, were the disk waited for
        bench.ask("record", on=True)
        bench.tick(10)
        assert bench.state is State.RUNNING
        now_s[0] += disk.LONGEST_WAIT_S + 1.0
        sent = len(bench.plant.sent)
        bench.tick()
        assert bench.plant.sent[sent:] == [CLOSED]
        assert "the disk has taken nothing for 2 s" in bench.reason
        assert_closed(bench)
        assert bench.loop.describe()["recording"] is None
    finally:
        thawed.set()


@pytest.mark.parametrize("plan", ["file", "campaign"])
def test_nothing_moves_where_the_logs_would_land_elsewhere(make_bench, write_test, tmp_path, plan):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "campaigns").symlink_to(tmp_path / "elsewhere")
    bench = make_bench()
    bench.run(**(write_test() if plan == "file" else WITHIN))
    bench.tick(20)
    assert set(bench.plant.sent) == {CLOSED}
    assert (bench.state, "is a link" in bench.reason) == (State.STOPPED, True)
    assert list((tmp_path / "elsewhere").iterdir()) == []


@pytest.mark.parametrize("plant", [Machine, Plant])
@pytest.mark.parametrize("late_s", [0.05, 0.2, 0.4, 3.0])
def test_a_tick_that_comes_late_ends_the_run(make_bench, write_test, late_s, plant):
    """A virtual bench may be as late as a server may be silent."""
    bench = make_bench(plant(), allow_output=True)
    bench.run(**write_test())
    bench.tick(20)
    bench.now_s += late_s
    sent = len(bench.plant.sent)
    bench.tick()
    if late_s > (LATEST_S if plant is Machine else bench_loop.LONGEST_SILENCE_S):
        assert bench.plant.sent[sent:] == [CLOSED]
        assert f"late by {late_s:.2g} s" in bench.reason or plant is Plant
        assert_closed(bench)
    else:
        assert bench.plant.sent[-1] == (0.6, 0.0)
        bench.ask("stop")
    bench.ask("reset")
    bench.now_s += 10.0  # nothing moves, nothing is late
    bench.tick()
    assert bench.state is State.IDLE


def test_a_disk_full_at_the_end_of_a_log_latches(make_bench, write_test, monkeypatch):
    bench = make_bench()
    bench.run(**write_test(duration_s=0.1))
    bench.tick(5)
    monkeypatch.setattr(recorder.os, "write", full_disk)
    bench.tick(10)
    assert "No space left on device" in bench.reason
    assert_closed(bench)


def silent_plant():
    plant = Plant()
    plant.is_silent = True
    return plant


@pytest.mark.parametrize(
    ("plant", "options", "plan", "message"),
    [
        (Machine, {}, {}, "--allow-output"),
        (Machine, {"limits": False, "allow_output": True}, {}, r"has no limits.*--limits"),
        (Machine, {"allow_output": True}, {**WITHIN, "unattended": True}, "unattended"),
        (Plant, {}, {"lifting": 1.2}, r"lifting_command reaches 1\.2 A; the limit is 0\.9"),
        (silent_plant, {}, {}, "no displacement is measured now"),
    ],
    ids=["no permission", "no limits", "unattended", "beyond the limits", "no sensor"],
)
def test_what_must_not_move_is_not_armed(make_bench, write_test, plant, options, plan, message):
    bench = make_bench(plant(), **options)
    bench.tick(5)
    with pytest.raises(InputError, match=message):
        bench.ask("arm", plan=plan if "kind" in plan else write_test(**plan))
    assert bench.state is State.IDLE
    bench.loop.close()
    assert set(bench.plant.sent) <= (set() if message == "--allow-output" else {CLOSED})


def test_a_machine_with_permission_and_limits_moves(make_bench, write_test):
    bench = make_bench(Machine(), allow_output=True)
    bench.run(**write_test(duration_s=0.1))
    bench.tick(2)
    assert bench.plant.sent[-1] == (0.6, 0.0)
    bench.tick(20)
    with pytest.raises(InputError, match="exists already; choose another name"):
        bench.ask("arm", plan=write_test())


def test_an_unattended_campaign_needs_the_server_but_not_its_page(make_bench):
    bench = make_bench()
    bench.run(**{**WITHIN, "unattended": True})
    bench.tick(200, page=False)
    assert bench.state is State.RUNNING
    bench.tick(60, page=False, server=False)
    assert "server" in bench.reason
    assert_closed(bench)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"is_silent": True}, "no displacement is measured now"),
        ({"displacement": 90.0}, "has moved since it was armed"),
    ],
)
def test_nothing_starts_after_a_change_since_it_was_armed(armed, change, message):
    for name, value in change.items():
        setattr(armed.plant, name, value)
    armed.tick(20)
    with pytest.raises(InputError, match=message):
        armed.ask("start")
    armed.tick(20)
    assert set(armed.plant.sent) == {CLOSED}


def test_the_run_of_an_operator_who_leaves_is_stopped(running):
    running.loop.operator_left()
    running.tick()
    assert (running.state, running.reason) == (State.STOPPED, "the operator left")
    assert_closed(running)


@pytest.mark.parametrize(
    ("attribute", "value", "more_limits", "message"),
    [
        ("step_s", 0.5, "", r"expected a sampling time of 0\.001 to 0\.1 s, got 0\.5 s"),
        ("signals", Plant.signals[::-1], "", "expected the signals lifting_command, lowering_command, displ"),
        ("label", "plant", 'command_unit = "mA"\n', "lifting_command is in mA, in plant in A"),
    ],
    ids=["too slow", "another order", "other units"],
)
def test_a_source_that_does_not_fit_is_refused(make_bench, tmp_path, attribute, value, more_limits, message):
    plant = Plant()
    setattr(plant, attribute, value)
    (tmp_path / "limits.toml").write_text(fake_bench.LIMITS_FILE + more_limits)
    with pytest.raises(InputError, match=message):
        make_bench(plant)


@pytest.fixture
def fast(make_bench):
    """Return a bench at twenty times the speed."""
    bench = make_bench()
    bench.ask("disconnect")
    bench.ask("connect", source="fake_bench:made", options={"speed": 20})
    return bench


def test_a_faster_bench_takes_each_sample_once(fast, write_test, tmp_path):
    bench = fast
    assert len(bench.tick()) == 1
    bench.run(**write_test())
    times = [reading.time_s for reading in bench.tick(10)]
    np.testing.assert_allclose(times, STEP_S * (3 + np.arange(200)), atol=1e-12)
    bench.ask("stop")
    assert len(bench.tick()) == 1
    time_s = rows_of(tmp_path / "campaigns" / "next" / "next.csv")[1][:, 0]
    np.testing.assert_allclose(time_s, STEP_S * np.arange(200), atol=1e-9)


@pytest.mark.parametrize("fault", ["is_lost", "is_silent"])
def test_a_faster_bench_stops_at_the_sample_of_a_fault(fast, write_test, fault):
    fast.run(**write_test())
    setattr(fast.plant, fault, True)
    fast.tick()
    assert sum(sent != CLOSED for sent in fast.plant.sent) <= 0.05 / STEP_S
    assert_closed(fast)


@pytest.mark.parametrize("speed", [0, -1, 21, "fast", 1.5, None, True])
def test_a_speed_that_is_none_opens_nothing(make_bench, speed):
    bench = make_bench()
    bench.ask("disconnect")
    with pytest.raises(InputError, match="speed"):
        bench.ask("connect", source="fake_bench:made", options={"speed": speed})
    assert (bench.state, bench.plant.is_open) == (State.DISCONNECTED, False)
    bench.plant.virtual = False
    with pytest.raises(InputError, match="speed: expected at most 1 here"):
        bench.ask("connect", source="fake_bench:made", options={"speed": 2})


def connecting(source, **options):
    return {"type": "connect", "source": source, "options": options}


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (connecting(""), "expected one of rig, replay"),
        (connecting("nothing"), "expected one of rig, replay"),
        (connecting("nowhere:Source"), "cannot be imported"),
        (connecting("fake_bench:nothing"), "cannot be imported"),
        (connecting("fake_bench:Bench"), "cannot be imported"),
        (connecting("math:gcd"), "is no source"),
        (connecting("udp:0"), "a port"),
        (connecting("udp:99999"), "a port"),
        (connecting(None), "expected one of"),
        *(
            (connecting("rig", rig=rig), "rig")
            for rig in ("/etc/passwd.toml", "../other.toml", "nowhere", None, {})
        ),
        *(
            (connecting("replay", log=log), "path")
            for log in ("../a.csv", "/etc/passwd", "uploads/none.csv", None, 3)
        ),
        *(
            (request, "is no request")
            for request in ({}, {"type": None}, {"type": "tick"}, {"type": ["stop"]})
        ),
        *(({"type": "target", "mm": mm}, "mm") for mm in (None, "high", float("nan"), float("inf"), [])),
        ({"type": "target", "mm": 100.0}, "there is no closed loop"),
    ],
)
def test_what_cannot_be_carried_out_is_refused(tmp_path, request_, message):
    with pytest.raises(InputError, match=message):
        BenchLoop(tmp_path).handle(request_, 0.0)


def test_the_state_is_content_for_json_whatever_happens(make_bench, write_test):
    bench = make_bench()
    bench.plant.is_silent = True
    bench.tick()
    json.dumps(bench.loop.describe(), allow_nan=False)
    bench.plant.is_silent = False
    bench.run(**write_test())
    bench.tick()
    content = json.loads(json.dumps(bench.loop.describe(), allow_nan=False))
    assert (content["state"], content["mode"]) == ("running", "lifting")
    assert content["limits"]["units"] == {"command": "A", "displacement": "mm"}
    assert content["run"]["folder"] == "campaigns/next"
