"""The closed loop follows the target of the operator, inside the travel."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fake_bench import LIMITS
from hitchid.hmi import drive_program
from hitchid.hmi.drive_program import Target, drive
from hitchid.hmi.limits import Limits


class Proportional:
    """A controller whose state counts the samples, and that commands 0.01 A for each millimetre."""

    def initial_state(self, displacement):
        return 0

    def step(self, state, reference, displacement):
        error = 0.01 * (reference - displacement)
        return state + 1, [max(error, 0.0), max(-error, 0.0)]


@pytest.fixture
def loop(monkeypatch):
    monkeypatch.setattr(
        drive_program, "load_controller", lambda _: SimpleNamespace(controller=Proportional())
    )
    target = Target(100.0)
    return drive(Path("a.toml"), "evening", 100.0, target, LIMITS), target


def test_it_holds_until_the_target_moves(loop):
    program, target = loop
    first = next(program)
    assert (first.log, first.phase) == ("evening", "driving")
    np.testing.assert_array_equal(first.commands, [0.0, 0.0])
    target.displacement = 150.0
    np.testing.assert_allclose(program.send(110.0).commands, [0.4, 0.0])
    np.testing.assert_allclose(program.send(170.0).commands, [0.0, 0.2])


@pytest.mark.parametrize(("target_mm", "reached_mm"), [(1e6, 210.0), (-1e6, 10.0)])
def test_a_target_outside_the_travel_is_its_end(monkeypatch, loop, target_mm, reached_mm):
    limits = Limits((0.9, 0.8), (10.0, 210.0))
    program = drive(Path("a.toml"), "evening", 100.0, Target(target_mm), limits)
    commands = next(program).commands
    assert commands[0] - commands[1] == pytest.approx(0.01 * (reached_mm - 100.0))
