"""A made-up plant for audits: tests with nothing wrong, into which a test plants one flaw."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hitchid.logs.audit import audit
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import COMMAND, DIRECTIONS, Record

STEP_S = 0.01


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


@pytest.fixture
def make_test():
    """Return a function that makes one clean test of a mode, at 100 Hz in mm and A."""

    def make(name, mode="lifting", *, seed=0, command=None, noise=0.05, samples=1200, **plant):
        rng = np.random.default_rng([seed, *name.encode()])
        command = prbs(rng, samples) if command is None else np.asarray(command, dtype=float)
        travel = driven(command, **plant)
        displacement = 10 + travel if mode == "lifting" else 150 - travel
        displacement = displacement + noise * rng.standard_normal(command.size)
        signals = {
            COMMAND[direction]: command if direction == mode else 0 * command for direction in DIRECTIONS
        }
        units = {"displacement": "mm"} | {COMMAND[direction]: "A" for direction in DIRECTIONS}
        return Record(name, STEP_S, {"displacement": displacement, **signals}, units)

    return make


@pytest.fixture
def clean(make_test):
    """Return the records of a campaign in which nothing is wrong: six tests and two ramps a mode."""
    ramp = np.linspace(0, 0.6, 2000)
    return [
        *(make_test(f"{mode}-{number}", mode) for mode in DIRECTIONS for number in range(1, 7)),
        *(make_test(f"ramp-{mode}-{number}", mode, command=ramp) for mode in DIRECTIONS for number in (1, 2)),
    ]


@pytest.fixture
def changed():
    """Return a function that replaces signals, units or other fields of a record."""

    def change(record, *, signals=None, units=None, **fields):
        return replace(
            record,
            signals={**record.signals, **(signals or {})},
            units={**record.units, **(units or {})},
            **fields,
        )

    return change


@pytest.fixture
def findings_of():
    """Return a function that audits records and gives the findings of one check, or all."""

    def find(records, check=None):
        findings = audit(Campaign.of(records))
        return [finding for finding in findings if check is None or finding.check == check]

    return find


@pytest.fixture
def planted(clean, changed):
    """Return a function that gives the clean campaign with another displacement in its first test."""
    return lambda displacement: [changed(clean[0], signals={"displacement": displacement}), *clean[1:]]
