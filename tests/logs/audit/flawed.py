"""A made-up plant for audits: tests with nothing wrong, into which a test plants one flaw."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from hitchid.logs.audit import audit
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import COMMAND, DIRECTIONS, Record

STEP_S = 0.01
UNITS = {"displacement": "mm"} | {COMMAND[direction]: "A" for direction in DIRECTIONS}


def driven(command, *, gain=40.0, zone=0.3, lag_s=0.05):
    """Return the travel of a lagged integrator behind a dead zone."""
    decay = np.exp(-STEP_S / lag_s)
    speed = lfilter([1 - decay], [1, -decay], gain * np.maximum(np.abs(command) - zone, 0))
    return np.concatenate([[0.0], np.cumsum(speed)[:-1]]) * STEP_S


def prbs(rng, samples, *, levels=(0.4, 0.6)):
    """Return a command that holds one of two levels for 0.3 to 1 s, after 0.5 s and before 0.5 s of rest."""
    holds = rng.integers(30, 100, samples // 30)
    command = np.repeat(rng.choice(levels, holds.size), holds)[: samples - 100]
    return np.concatenate([np.zeros(50), command, np.zeros(50)])


def make_test(name, mode="lifting", *, seed=0, command=None, noise=0.05, samples=1200, **plant):
    """Return one clean test of a mode, at 100 Hz in mm and A."""
    rng = np.random.default_rng([seed, *name.encode()])
    command = prbs(rng, samples) if command is None else np.asarray(command, dtype=float)
    travel = driven(command, **plant)
    displacement = 10 + travel if mode == "lifting" else 150 - travel
    displacement = displacement + noise * rng.standard_normal(command.size)
    commands = {COMMAND[direction]: command if direction == mode else 0 * command for direction in DIRECTIONS}
    return Record(name, STEP_S, {"displacement": displacement, **commands}, UNITS)


def make_tests(count, **options):
    """Return clean lifting tests that differ in their noise, l-0, l-1, …."""
    return [make_test(f"l-{number}", **options) for number in range(count)]


def changed(record, displacement=None, *, signals=None, units=None, **fields):
    """Return a record with another displacement, other signals, units or fields."""
    signals = {**record.signals, **(signals or {})}
    signals |= {} if displacement is None else {"displacement": displacement}
    return replace(record, signals=signals, units={**record.units, **(units or {})}, **fields)


def rounded(records, quantum):
    """Return records whose displacement is rounded to a step."""
    return [changed(record, quantum * np.round(record.displacement / quantum)) for record in records]


def findings_of(records, check=None):
    """Audit records; return the findings of one check, or all."""
    findings = audit(Campaign.of(records))
    return [finding for finding in findings if check is None or finding.check == check]
