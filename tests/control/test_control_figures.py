"""Figures of loops made by hand, of which the answers are known."""

from dataclasses import replace

import numpy as np
import pytest

from hitchid.control.closed_loop import ClosedLoops, Surroundings
from hitchid.control.drive import Figures, iae_ratios
from hitchid.control.scenarios import Kind, Scenario

BEGIN, SAMPLES, START = 100, 500, 100.0


def scenario(amplitude: float = 20.0, **changed) -> Scenario:
    target = np.where(np.arange(SAMPLES) < BEGIN, START, START + amplitude)
    step = Scenario("step", Kind.STEP, target, START, BEGIN, amplitude=amplitude)
    changed = {"tolerance": 1.0 if abs(amplitude) == 5 else 2.0, **changed}
    return replace(step, **changed)


def loops_of(own: Scenario, *displacements, measured=None, currents=None) -> ClosedLoops:
    rows = np.stack(displacements or [own.target])
    readings = rows if measured is None else np.stack(measured)
    currents = np.zeros((*rows.shape, 2)) if currents is None else np.asarray(currents)
    return ClosedLoops(own.target, rows, readings, currents)


def arriving(own: Scenario, after: int, beyond: float = 0.0):
    """Return a displacement that jumps `after` samples, `beyond` the target for the 10 that follow."""
    displacement = np.where(np.arange(SAMPLES) < BEGIN + after, START, own.target)
    displacement[BEGIN + after : BEGIN + after + 10] += beyond
    return displacement


@pytest.mark.parametrize("amplitude", [20.0, -20.0])
def test_a_loop_on_its_target_has_no_error(amplitude: float) -> None:
    own = scenario(amplitude)
    figures = Figures.of(own, loops_of(own))
    assert figures == Figures(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, None, 0)


@pytest.mark.parametrize("amplitude", [20.0, -20.0])
def test_a_late_jump_settles_when_it_arrives(amplitude: float) -> None:
    own = scenario(amplitude)
    figures = Figures.of(own, loops_of(own, arriving(own, 150)))
    assert figures.settling_s == pytest.approx(1.5)
    assert figures.iae == pytest.approx(20.0 * 1.5)
    assert figures.rmse == pytest.approx(np.sqrt(400 * 150 / 400))
    assert figures.overshoot == 0


@pytest.mark.parametrize("amplitude", [20.0, -20.0])
def test_overshoot_is_what_lies_beyond_the_end_of_the_step(amplitude: float) -> None:
    own = scenario(amplitude)
    figures = Figures.of(own, loops_of(own, arriving(own, 150, np.sign(amplitude) * 3.0)))
    assert figures.overshoot == pytest.approx(3.0)
    assert figures.settling_s == pytest.approx(1.6)


@pytest.mark.parametrize(("amplitude", "settled"), [(5.0, 1.6), (20.0, 1.5)])
def test_a_small_step_has_the_narrower_tolerance(amplitude: float, settled: float) -> None:
    own = scenario(amplitude)
    figures = Figures.of(own, loops_of(own, arriving(own, 150, 1.5)))
    assert figures.settling_s == pytest.approx(settled)


def test_a_loop_that_is_outside_at_the_end_never_settles() -> None:
    own = scenario()
    assert Figures.of(own, loops_of(own, own.target + 2.1)).settling_s == np.inf
    assert Figures.of(own, loops_of(own, own.target + 1.9)).settling_s == 0


def test_a_displacement_that_is_not_finite_diverged_and_never_settles() -> None:
    own = scenario()
    broken = own.target.copy()
    broken[-1] = np.nan
    figures = Figures.of(own, loops_of(own, broken, own.target))
    assert figures.diverged == 1
    assert figures.settling_s == np.inf


def test_final_error_is_the_mean_of_the_last_second() -> None:
    own = scenario()
    measured = own.target.copy()
    measured[:-100] += 7.0
    measured[-100:] += np.where(np.arange(100) % 2, 0.4, -0.2)
    measured[-1] = np.nan
    figures = Figures.of(own, loops_of(own, measured=[measured]))
    assert figures.final_error == pytest.approx(abs(0.4 * 49 - 0.2 * 50) / 99)


def test_figures_of_many_loops_are_those_of_95_percent() -> None:
    own = scenario()
    rows = [own.target + error for error in np.linspace(0.0, 1.0, 101)]
    figures = Figures.of(own, loops_of(own, *rows))
    assert figures.rmse == pytest.approx(0.95)
    assert figures.final_error == pytest.approx(0.95)
    assert figures.iae == pytest.approx(0.5 * 4.0)


def test_settling_of_many_loops_is_that_of_95_percent() -> None:
    own = scenario()
    rows = [arriving(own, after) for after in range(1, 21)]
    assert Figures.of(own, loops_of(own, *rows)).settling_s == pytest.approx(0.19)


def test_valves_are_counted_that_open_and_both_on() -> None:
    own = scenario()
    currents = np.zeros((1, SAMPLES, 2))
    currents[0, 100:120, 0] = currents[0, 200:210, 0] = 0.5
    currents[0, 115:140, 1] = 0.4
    figures = Figures.of(own, loops_of(own, currents=currents))
    assert figures.both_valves_samples == 5
    assert figures.valve_actions_per_10_s == pytest.approx(6.0)


@pytest.mark.parametrize(("still_on", "expected"), [(0, 0), (1, 1), (4, 4)])
def test_samples_until_closed_are_those_with_current_after_the_loss(still_on: int, expected: int) -> None:
    lost = np.zeros(SAMPLES, bool)
    lost[200:250] = True
    own = scenario(surroundings=Surroundings(sensor_lost=lost))
    currents = np.zeros((2, SAMPLES, 2))
    currents[:, 150:200, 0] = 0.5
    currents[1, 200 : 200 + still_on, 0] = 0.5
    assert (
        Figures.of(own, loops_of(own, own.target, own.target, currents=currents)).samples_until_closed
        == expected
    )


def test_only_steps_have_overshoot_and_settling() -> None:
    own = scenario(0.0)
    figures = Figures.of(own, loops_of(own))
    assert figures.overshoot is None
    assert figures.settling_s is None


def test_ratios_are_geometric_means_in_which_kinds_count_alike() -> None:
    kinds = {"a": Kind.STEP, "b": Kind.STEP, "c": Kind.RAMP, "d": Kind.SINE, "e": Kind.HOLD}
    base = Figures(1.0, 0.0, None, None, 0.0, 0.0, 0, None, 0)
    sizes = {"a": 0.5, "b": 2.0, "c": 4.0, "d": 0.25, "e": 99.0}
    ratios = iae_ratios(
        {name: base._replace(iae=3 * size) for name, size in sizes.items()},
        {name: base._replace(iae=3.0) for name in sizes},
        kinds,
    )
    assert ratios == pytest.approx({"all": 1.0, "step": 1.0, "ramp": 4.0, "sine": 0.25})
