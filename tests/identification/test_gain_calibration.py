"""Gains levelled so that whole records in free run agree."""

from dataclasses import replace

import numpy as np
import pytest

import handmade
from handmade import GAINS
from hitchid.identification.mode_test import MAX_LOG_FACTOR, calibrate_gains, calibration_improves, scaled
from hitchid.logs.record import LIFTING, LOWERING

HITCH = handmade.hitch("integrator")
SAMPLES = 400


@pytest.fixture
def simulated(make_record):
    """Return a function that lets a hitch run freely over a few mixed records."""

    def make(hitch, count=2):
        records = []
        for number in range(count):
            rng = np.random.default_rng(number)
            on = np.repeat(rng.uniform(0.4, 0.9, SAMPLES // 50), 50)
            lifts = np.repeat(np.arange(SAMPLES // 50) % 3 == 0, 50)
            moving = np.arange(SAMPLES) >= 10
            up, down = on * lifts * moving, on * ~lifts * moving
            commands = make_record(np.full(SAMPLES, 100.0 * (number + 1)), up, down, name=f"mixed-{number}")
            run = hitch.simulate(commands).displacement
            records.append(replace(commands, signals={**commands.signals, "displacement": run}))
        return records

    return make


def gains(hitch):
    return {mode: float(channel.benchmark.values[0]) for mode, channel in hitch.channels.items()}


def test_a_factor_multiplies_the_gain_of_its_channel_alone():
    moved = scaled(HITCH, {LIFTING: 1.5})
    assert gains(moved) == {LIFTING: 1.5 * GAINS[LIFTING], LOWERING: GAINS[LOWERING]}
    assert gains(HITCH) == GAINS


def test_factors_put_on_the_gains_are_found_again(simulated):
    factors = {LIFTING: 1.03, LOWERING: 0.96}
    found = calibrate_gains(HITCH, simulated(scaled(HITCH, factors)))
    # The integrator is linear in its gains: least squares stops at a relative change of 1e-8.
    assert found == pytest.approx(factors, rel=1e-6)


def test_gains_that_agree_stay(simulated):
    assert calibrate_gains(HITCH, simulated(HITCH)) == pytest.approx({LIFTING: 1.0, LOWERING: 1.0}, abs=1e-6)


def test_no_factor_goes_farther_than_its_bound(simulated):
    found = calibrate_gains(HITCH, simulated(scaled(HITCH, {LIFTING: 1.5, LOWERING: 1.5})))
    assert max(found.values()) == pytest.approx(np.exp(MAX_LOG_FACTOR), rel=1e-3)
    assert all(-MAX_LOG_FACTOR <= np.log(factor) <= MAX_LOG_FACTOR + 1e-12 for factor in found.values())


def test_factors_that_all_records_share_prove_themselves(simulated):
    records = simulated(scaled(HITCH, {LIFTING: 1.03, LOWERING: 0.96}), count=4)
    assert calibration_improves(HITCH, records)


def test_one_record_proves_nothing(simulated):
    assert not calibration_improves(HITCH, simulated(scaled(HITCH, {LIFTING: 1.03}), count=1))


def test_records_that_differ_prove_nothing(simulated):
    factors = (1.03, 0.97, 1.02, 0.98)
    records = [
        simulated(scaled(HITCH, {LIFTING: factor, LOWERING: factor}), count=4)[number]
        for number, factor in enumerate(factors)
    ]
    assert not calibration_improves(HITCH, records)
