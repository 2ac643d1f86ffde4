"""Campaigns that choose their own tests, as a whole: killed, resumed, on a slow machine, behind UDP."""

import json
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import hitchid
from fake_bench import LIMITS, LIMITS_FILE, STEP_S, Plant
from hitchid.errors import InputError
from hitchid.hmi import Signal
from hitchid.hmi.plans import Limits

EXAMPLE = Path(__file__).parents[2] / "examples" / "plant_in_c"
PROGRAM = [sys.executable, "-m", "hitchid", "campaign"]


def logs_of(folder):
    return sorted(log.name for log in folder.glob("*.csv"))


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        return other.getsockname()[1]


def test_limits_are_required_and_the_goal_is_in_the_machines_unit(tmp_path):
    with pytest.raises(InputError, match="plant: has no limits; give the limits file of the machine"):
        hitchid.campaign(Plant(), tmp_path)
    with pytest.raises(InputError, match=r"goal: expected an error in mm, the unit .*, got deg"):
        hitchid.campaign(Plant(), tmp_path, limits=LIMITS, goal="free run 1 deg in 10 s")


def test_source_without_a_displacement_is_told(tmp_path):
    silent = Plant()
    silent.is_silent = True
    with pytest.raises(InputError, match="plant: sent no displacement for 10 s"):
        hitchid.campaign(silent, tmp_path, limits=LIMITS)


class Slow(Plant):
    """A lift in degrees and percent, sampled ten times a second, with noise of its sensor."""

    step_s = 0.1
    signals = (
        Signal("lifting_command", "Lifting", "percent", "command"),
        Signal("lowering_command", "Lowering", "percent", "command"),
        Signal("displacement", "Angle", "deg", "displacement"),
    )

    def __init__(self):
        super().__init__(-20.0, dead_zones=(20.0, 15.0))
        self.random, self.noise_deg = np.random.default_rng(0), 0.02

    def read(self):
        (reading,) = super().read()
        noisy = reading.values[2] + self.noise_deg * self.random.standard_normal()
        return (reading._replace(time_s=self.sample * self.step_s, values=(*reading.values[:2], noisy)),)

    def advance(self, commands):
        up, down = np.array([0.4, 0.3]) * np.maximum(np.asarray(commands) - self.dead_zones, 0.0)
        self.displacement = float(np.clip(self.displacement + self.step_s * (up - down), -30.0, 40.0))
        self.sample += 1


@pytest.mark.long
def test_lift_in_degrees_and_percent_at_ten_hertz_is_known_to_its_noise(tmp_path):
    limits = Limits(
        lifting_command=80.0,
        lowering_command=70.0,
        lowest_displacement=-30.0,
        highest_displacement=40.0,
        command_unit="percent",
        displacement_unit="deg",
    )
    lift = Slow()
    result = hitchid.campaign(lift, tmp_path, limits=limits, minutes=1.8)
    assert result.reason == "the time is over: 1.8 minutes"
    sent = np.array(lift.sent)
    assert np.all(sent <= (80.0, 70.0))
    assert not np.any(np.all(sent > 0, axis=1))
    assert hitchid.read(result.folder).units["displacement"] == "deg"
    for errors in result.rounds[-1]["directions"].values():
        # Rounded to the sensor's noise, which a model of the right form reaches with some tests.
        assert errors["rmse"] < 3 * lift.noise_deg


@pytest.mark.long
def test_campaign_killed_time_and_again_goes_on_and_loses_nothing(tmp_path):
    folder, lines = tmp_path / "campaigns" / "campaign", 0
    logs, resume = [], []
    for kill in range(5):
        arguments = [str(tmp_path), "--minutes", "1.6", *resume]
        with subprocess.Popen([*PROGRAM, *arguments], stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
            # At another moment each time: in the careful start, in a test, while it is planned, …
            for _ in range(1 + kill % 4):
                lines += bool(process.stderr.readline())
            time.sleep(0.15 * kill)
            process.send_signal(signal.SIGKILL)
        before, logs = logs, logs_of(folder)
        assert set(before) <= set(logs)
        resume = ["--resume"] if folder.is_dir() else []
    command = [*PROGRAM, str(tmp_path), "--minutes", "1.6", *resume, "--json"]
    done = subprocess.run(command, capture_output=True, text=True)  # noqa: S603
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["minutes"] <= 2.0
    assert set(logs) <= set(logs_of(folder))
    campaign = hitchid.read(folder)
    assert {"lifting", "lowering"} <= {record.kind for record in campaign.records}


class Machine(threading.Thread):
    """A machine behind UDP that keeps what it was told."""

    def __init__(self, port):
        super().__init__(daemon=True)
        self.link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link.connect(("127.0.0.1", port))
        self.link.setblocking(False)
        self.plant, self.commands, self.ends = Plant(60.0, lag_s=0.05), np.zeros(2), False

    def run(self):
        due_s = time.monotonic()
        while not self.ends:
            sample = {"time_s": self.plant.sample * STEP_S, "displacement": self.plant.displacement}
            try:
                self.link.send(json.dumps(sample).encode())
                while True:
                    line = json.loads(self.link.recv(4096))
                    self.commands = np.array([line["lifting_command"], line["lowering_command"]])
            except OSError:  # nobody listens, or nothing more has come
                pass
            self.plant.write(self.commands)
            due_s += STEP_S
            time.sleep(max(0.0, due_s - time.monotonic()))


@pytest.mark.long
def test_killed_campaign_leaves_a_machine_at_rest(tmp_path):
    (tmp_path / "limits.toml").write_text(LIMITS_FILE)
    port = free_port()
    machine = Machine(port)
    machine.start()
    options = ["--source", f"udp:{port}", "--limits", str(tmp_path / "limits.toml")]
    command = [*PROGRAM, str(tmp_path / "project"), *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
        end_s = time.monotonic() + 60
        while not machine.commands.any():  # it moves
            assert time.monotonic() < end_s
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    end_s = time.monotonic() + 10
    while machine.commands.any():  # until its watchdog has sent zero
        assert time.monotonic() < end_s
        time.sleep(0.01)
    machine.ends = True


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_example_in_c_is_tested_and_identified(tmp_path):
    plant = tmp_path / "plant"
    subprocess.run(["cc", "-O2", "-Wall", "-Werror", EXAMPLE / "plant.c", "-lm", "-o", plant], check=True)  # noqa: S603, S607
    port = free_port()
    options = ["--source", f"udp:{port}", "--limits", str(EXAMPLE / "limits.toml"), "--minutes", "1.5"]
    with subprocess.Popen([plant, str(port)]) as machine:  # noqa: S603
        try:
            command, folder = [*PROGRAM, str(tmp_path / "project"), *options], tmp_path / "project"
            for _ in range(5):  # a busy host may hold up the loop, which then stops; it goes on where it was
                done = subprocess.run(command, capture_output=True, text=True)  # noqa: S603
                command = [*command, "--resume"] if "--resume" not in command else command
                if done.returncode == 0:
                    break
        finally:
            machine.kill()
    if "was late by" in done.stderr.splitlines()[-1]:
        pytest.skip("the host is too busy for a loop in real time")
    assert done.returncode == 0, done.stderr
    identified = hitchid.identify(
        hitchid.read(folder / "campaigns" / "campaign"), training=None, rivals=None, progress=False
    )
    # As the plant's constants say, 0.3 A beyond the dead zones; a sensor without noise.
    assert identified.model.speed(0.65, "lifting").speed == pytest.approx(27.0, rel=0.05)
    assert identified.model.speed(0.55, "lowering").speed == pytest.approx(-21.0, rel=0.05)
