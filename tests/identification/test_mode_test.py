"""Does a plant need two modes: equal directions need one, unlike ones two."""

import numpy as np
import pytest

from benches import binary_command, lagged_integrator
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.mode_test import compare_modes
from hitchid.identification.preparation import prepare
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import TwoModes
from hitchid.model.provenance import DifferenceTest

ZONE, SAMPLES, NOISE = 0.35, 200, 0.02
DIRECTIONS = {LIFTING: 1, LOWERING: -1}


@pytest.fixture
def prepared(make_record):
    """Return a function that prepares tests of a plant with one gain for each direction given."""

    def make(tests=6, **gains):
        rng, records = np.random.default_rng(1), []
        for mode, gain in gains.items():
            for number in range(tests):
                command = binary_command(rng, SAMPLES, 0.45, rng.uniform(0.5, 0.7))
                travel = lagged_integrator(command, gain=gain, time_constant=0.08, dead_zone=ZONE)
                measured = 100 + DIRECTIONS[mode] * travel + NOISE * rng.standard_normal(SAMPLES)
                commands = (command, 0 * command) if mode == LIFTING else (0 * command, command)
                records.append(make_record(measured, *commands, name=f"{mode}-{number}"))
        # One test more than is identified from is held out.
        campaign = Campaign.of(records, test_patterns=[f"*-{tests - 1}"])
        return {mode: prepare(campaign, mode, DeadZone(ZONE, None, 0, "given")) for mode in gains}

    return make


def test_for_directions_that_mirror_each_other_one_mode_would_do(prepared):
    found = compare_modes(prepared(lifting=30.0, lowering=30.0))
    assert not found.needed
    assert found.difference.p_value > 0.05
    assert found.tests == 10
    # The truth leaves the noise, of which a test's start takes a share of its own.
    for rmse in (found.shared_rmse, found.two_rmse):
        assert NOISE / 2 < rmse < 2 * NOISE
    assert found.sentence.startswith("the two directions do not differ significantly")


def test_a_plant_with_half_the_gain_one_way_needs_two_modes(prepared):
    found = compare_modes(prepared(lifting=30.0, lowering=15.0))
    assert found.needed
    assert found.difference.p_value < 1e-3
    assert "gain" in found.difference.parameters
    assert NOISE / 2 < found.two_rmse < 2 * NOISE
    assert found.shared_rmse > 10 * found.two_rmse
    assert found.sentence.startswith("the two directions differ significantly")


def test_an_error_that_two_models_make_much_smaller_is_not_called_insignificant():
    difference = DifferenceTest(3.0, ("gain",), 3.0, 0.2)
    few = TwoModes(needed=False, shared_rmse=6.3, two_rmse=1.6, tests=8, difference=difference)
    assert few.sentence.startswith("two models err 3.94 times less than one")
    alike = TwoModes(needed=False, shared_rmse=1.7, two_rmse=1.6, tests=8, difference=difference)
    assert alike.sentence.startswith("the two directions do not differ significantly")


def test_one_direction_cannot_be_compared(prepared):
    assert compare_modes(prepared(lifting=30.0)) is None
    assert compare_modes({}) is None


def test_too_few_tests_cannot_be_compared(prepared):
    # One test more than identified from is held out: three for as many parameters.
    assert compare_modes(prepared(tests=4, lifting=30.0, lowering=15.0)) is None
