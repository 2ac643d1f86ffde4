"""What both directions say together: whether a plant needs two modes, and the gains of whole records."""

from dataclasses import replace

import numpy as np
import pytest

import handmade
from benches import binary_command, lagged_integrator
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.mode_test import (
    MAX_LOG_FACTOR,
    calibrate_gains,
    calibration_improves,
    compare_modes,
    scaled,
)
from hitchid.identification.preparation import prepare
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import TwoModes
from hitchid.model.provenance import DifferenceTest

ZONE, SAMPLES, NOISE = 0.35, 200, 0.02
HITCH = handmade.hitch("integrator")


@pytest.fixture
def prepared(make_record):
    """Return a function that prepares tests of a plant with one gain for each direction given."""

    def make(tests=6, **gains):
        rng, records = np.random.default_rng(1), []
        for mode, gain in gains.items():
            for number in range(tests):
                command = binary_command(rng, SAMPLES, 0.45, rng.uniform(0.5, 0.7))
                travel = lagged_integrator(command, gain=gain, time_constant=0.08, dead_zone=ZONE)
                measured = 100 + handmade.DIRECTIONS[mode] * travel + NOISE * rng.standard_normal(SAMPLES)
                commands = (command, 0 * command) if mode == LIFTING else (0 * command, command)
                records.append(make_record(measured, *commands, name=f"{mode}-{number}"))
        # One test more than is identified from is held out.
        campaign = Campaign.of(records, test_patterns=[f"*-{tests - 1}"])
        return {mode: prepare(campaign, mode, DeadZone(ZONE, None, 0, "given")) for mode in gains}

    return make


def test_for_directions_that_mirror_each_other_one_mode_would_do(prepared):
    comparison = compare_modes(prepared(lifting=30.0, lowering=30.0))
    assert not comparison.needed
    assert comparison.difference.p_value > 0.05
    assert comparison.tests == 10
    # The truth leaves the noise, of which a test's start takes a share of its own.
    for rmse in (comparison.shared_rmse, comparison.two_rmse):
        assert NOISE / 2 < rmse < 2 * NOISE
    assert comparison.sentence.startswith("the two directions do not differ significantly")


def test_half_the_gain_one_way_needs_two_modes(prepared):
    comparison = compare_modes(prepared(lifting=30.0, lowering=15.0))
    assert comparison.needed
    assert comparison.difference.p_value < 1e-3
    assert "gain" in comparison.difference.parameters
    assert NOISE / 2 < comparison.two_rmse < 2 * NOISE
    assert comparison.shared_rmse > 10 * comparison.two_rmse
    assert comparison.sentence.startswith("the two directions differ significantly")


def test_a_much_smaller_error_is_not_called_insignificant():
    difference = DifferenceTest(3.0, ("gain",), 3.0, 0.2)
    few = TwoModes(needed=False, shared_rmse=6.3, two_rmse=1.6, tests=8, difference=difference)
    assert few.sentence.startswith("two models err 3.94 times less than one")
    alike = TwoModes(needed=False, shared_rmse=1.7, two_rmse=1.6, tests=8, difference=difference)
    assert alike.sentence.startswith("the two directions do not differ significantly")


def test_one_direction_or_too_few_tests_cannot_be_compared(prepared):
    assert compare_modes(prepared(lifting=30.0)) is None
    # One test more than identified from is held out: three for as many parameters.
    assert compare_modes(prepared(tests=4, lifting=30.0, lowering=15.0)) is None


@pytest.fixture
def simulated(make_record):
    """Return a function that lets a hitch run freely over a mixed record."""

    def make(hitch, number):
        rng = np.random.default_rng(number)
        on = np.repeat(rng.uniform(0.4, 0.9, 8), 50)
        lifts = np.repeat(np.arange(8) % 3 == 0, 50)
        moving = np.arange(on.size) >= 10
        up, down = on * lifts * moving, on * ~lifts * moving
        commands = make_record(np.full(on.size, 100.0 * (number + 1)), up, down, name=f"mixed-{number}")
        run = hitch.simulate(commands).displacement
        return replace(commands, signals={**commands.signals, "displacement": run})

    return make


@pytest.mark.parametrize("factors", [{LIFTING: 1.03, LOWERING: 0.96}, {LIFTING: 1.0, LOWERING: 1.0}])
def test_factors_put_on_the_gains_are_found_again(simulated, factors):
    moved = scaled(HITCH, factors)
    gains = {mode: float(channel.benchmark.values[0]) for mode, channel in moved.channels.items()}
    assert gains == {mode: factor * handmade.GAINS[mode] for mode, factor in factors.items()}
    calibrated = calibrate_gains(HITCH, [simulated(moved, number) for number in range(2)])
    # The integrator is linear in its gains: least squares stops at a relative change of 1e-8.
    assert calibrated == pytest.approx(factors, rel=1e-6)


def test_no_factor_goes_farther_than_its_bound(simulated):
    moved = scaled(HITCH, {LIFTING: 1.5, LOWERING: 1.5})
    calibrated = calibrate_gains(HITCH, [simulated(moved, number) for number in range(2)])
    assert max(calibrated.values()) == pytest.approx(np.exp(MAX_LOG_FACTOR), rel=1e-3)
    assert all(-MAX_LOG_FACTOR <= np.log(factor) <= MAX_LOG_FACTOR + 1e-12 for factor in calibrated.values())


@pytest.mark.parametrize(
    ("factors", "improves"),
    [([(1.03, 0.96)] * 4, True), ([(1.03, 1.0)], False), ([(f, f) for f in (1.03, 0.97, 1.02, 0.98)], False)],
    ids=["shared by all records", "of one record", "of records that differ"],
)
def test_factors_are_used_only_where_several_records_share_them(simulated, factors, improves):
    records = [
        simulated(scaled(HITCH, {LIFTING: up, LOWERING: down}), number)
        for number, (up, down) in enumerate(factors)
    ]
    assert calibration_improves(HITCH, records) == improves
