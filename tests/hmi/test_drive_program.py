"""The closed loop follows the target of the operator, inside the travel."""

import numpy as np
import pytest

from fake_bench import LIMITS
from hitchid.errors import InputError
from hitchid.hmi.plans import Limits
from hitchid.hmi.program import Target, check_clock_and_units, drive


class Proportional:
    """A controller whose state counts the samples, and that commands 0.01 A for each millimetre."""

    def initial_state(self, displacement):
        return 0

    def step(self, state, reference, displacement):
        error = 0.01 * (reference - displacement)
        return state + 1, [max(error, 0.0), max(-error, 0.0)]


@pytest.fixture
def loop():
    target = Target(100.0)
    return drive(Proportional(), "evening", 100.0, target, LIMITS), target


def test_it_holds_until_the_target_moves(loop):
    program, target = loop
    first = next(program)
    assert (first.log, first.phase) == ("evening", "driving")
    np.testing.assert_array_equal(first.commands, [0.0, 0.0])
    target.displacement = 150.0
    np.testing.assert_allclose(program.send(110.0).commands, [0.4, 0.0])
    np.testing.assert_allclose(program.send(170.0).commands, [0.0, 0.2])


@pytest.mark.parametrize(("target_mm", "reached_mm"), [(1e6, 210.0), (-1e6, 10.0)])
def test_a_target_outside_the_travel_is_its_end(target_mm, reached_mm):
    limits = Limits((0.9, 0.8), (10.0, 210.0))
    program = drive(Proportional(), "evening", 100.0, Target(target_mm), limits)
    commands = next(program).commands
    assert commands[0] - commands[1] == pytest.approx(0.01 * (reached_mm - 100.0))


@pytest.mark.parametrize(
    ("step_s", "changed", "problem"),
    [
        (0.02, {}, "sampling time of 0.01 s, the source of 0.02 s"),
        (0.01, {"displacement": "m"}, "expected displacement in mm, the source has m"),
        (0.01, {"lowering_command": "mA"}, "expected lowering_command in A, the source has mA"),
    ],
)
def test_a_controller_does_not_drive_a_source_with_another_clock_or_other_units(step_s, changed, problem):
    units = {"lifting_command": "A", "lowering_command": "A", "displacement": "mm"}
    check_clock_and_units(0.01, units, 0.01, units)
    with pytest.raises(InputError) as error:
        check_clock_and_units(0.01, units, step_s, {**units, **changed})
    assert problem in str(error.value)
