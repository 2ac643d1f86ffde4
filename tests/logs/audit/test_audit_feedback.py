"""Logs recorded under feedback are found; the same commands in open loop are not."""

from dataclasses import replace

import numpy as np
import pytest
from flawed import findings_of

from hitchid.logs import read
from hitchid.logs.audit import Severity, audit, feedback_of
from hitchid.logs.record import LIFTING, RAMP

STEP_S, GAIN, LAG_S, ZONE = 0.01, 40.0, 0.05, 0.05
SAMPLES = 1000


def recorded(make_record, rng, *, setpoint=None, command=None, noise=0.05, disturbance=1.0, stop=None):
    """Return a test of a lagged integrator with a coloured disturbance, driven by a setpoint or a command."""
    decay, fading = np.exp(-STEP_S / LAG_S), np.exp(-STEP_S / 1.0)
    position, valve, speed = 10.0, 0.0, 0.0
    commands, displacements = np.zeros(SAMPLES), np.zeros(SAMPLES)
    for k in range(SAMPLES):
        displacements[k] = position + noise * rng.standard_normal()
        if command is not None:
            commands[k] = command[k] if stop is None or position < stop else 0.0
        else:
            commands[k] = np.clip(0.1 * (setpoint[k] - displacements[k]), -1.0, 1.0)
        valve = decay * valve + (1 - decay) * commands[k]
        speed = fading * speed + disturbance * np.sqrt(1 - fading**2) * rng.standard_normal()
        position += STEP_S * (GAIN * np.sign(valve) * max(abs(valve) - ZONE, 0.0) ** 1.3 + speed)
    return replace(make_record(displacements, commands), kind=LIFTING)


def steps(rng):
    """Return a setpoint of five random steps, mm."""
    return np.repeat(rng.uniform(10, 60, 5), SAMPLES // 5)


def switched(rng, hold):
    """Return a command that takes one of two levels every `hold` samples."""
    return np.repeat(rng.choice([0.4, 0.6], SAMPLES // hold), hold)


@pytest.mark.parametrize("tests", [1, 6])
@pytest.mark.parametrize("disturbance", [0.0, 1.0])
def test_a_controller_is_found(make_record, tests, disturbance):
    rng = np.random.default_rng(1)
    records = [recorded(make_record, rng, setpoint=steps(rng), disturbance=disturbance) for _ in range(tests)]
    evidence = feedback_of(records)
    assert evidence is not None
    assert evidence.tests == tests
    # The command of a proportional controller is lower where the displacement is higher than predicted.
    assert evidence.correlation < 0
    assert "depends on past displacement" in evidence.sentence


def test_the_commands_of_a_controller_replayed_are_no_feedback(make_record):
    rng = np.random.default_rng(2)
    under_feedback = [recorded(make_record, rng, setpoint=steps(rng)) for _ in range(6)]
    replayed = [recorded(make_record, rng, command=test.command("lifting")) for test in under_feedback]
    assert feedback_of(under_feedback) is not None
    assert feedback_of(replayed) is None


@pytest.mark.parametrize(("hold", "measured"), [(5, 0.003), (20, 0.0), (50, 0.003)])
def test_a_switched_command_is_no_feedback_though_the_valve_is_curved(make_record, hold, measured):
    """Neither exact nor measured with noise, when the residual of a linear regression has structure."""
    for seed in range(4):
        rng = np.random.default_rng([3, seed])
        records = []
        for _ in range(6):
            test = recorded(make_record, rng, command=switched(rng, hold))
            command = test.command("lifting") + measured * rng.standard_normal(SAMPLES)
            records.append(replace(make_record(test.displacement, command), kind=LIFTING))
        assert feedback_of(records) is None


def test_a_constant_command_that_a_limit_switch_ends_is_no_feedback(make_record):
    rng = np.random.default_rng(4)
    level = rng.uniform(0.4, 0.8, 6)
    records = [recorded(make_record, rng, command=np.full(SAMPLES, held), stop=40.0) for held in level]
    assert feedback_of(records) is None


def test_short_tests_ramps_and_silence_are_no_evidence(make_record):
    rng = np.random.default_rng(5)
    short = make_record(rng.standard_normal(100), rng.standard_normal(100))
    constant = make_record(np.zeros(SAMPLES), rng.standard_normal(SAMPLES))
    records = [replace(test, kind=LIFTING) for test in (short, constant)]
    records.append(replace(recorded(make_record, rng, setpoint=steps(rng)), kind=RAMP))
    assert feedback_of([]) is None
    assert feedback_of(records) is None


def test_the_audit_warns_and_tells_what_to_log(make_record):
    rng = np.random.default_rng(6)
    (finding,) = findings_of([recorded(make_record, rng, setpoint=steps(rng))], "feedback")
    assert finding.severity is Severity.WARNING
    assert "log the setpoint" in finding.advice


@pytest.mark.parametrize(
    ("name", "under_feedback"),
    [
        ("rig-a", False),
        ("excavator-boom", False),
        ("electro-hydraulic-actuator", False),
        ("hanging-load", True),
        ("field-excavator", True),
    ],
)
def test_measured_logs(data, name, under_feedback):
    """A controller moves the hanging load and an operator the field excavator; in the others none is seen."""
    checks = {finding.check for finding in audit(read([data(name)]))}
    assert ("feedback" in checks) == under_feedback
