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


def figures_of(own: Scenario, *displacements, measured=None, currents=None) -> Figures:
    rows = np.stack(displacements or [own.target])
    readings = rows if measured is None else np.stack(measured)
    currents = np.zeros((*rows.shape, 2)) if currents is None else np.asarray(currents)
    return Figures.of(own, ClosedLoops(own.target, rows, readings, currents))


def arriving(own: Scenario, after: int, beyond: float = 0.0):
    """Return a displacement that jumps `after` samples, `beyond` the target for the 10 that follow."""
    displacement = np.where(np.arange(SAMPLES) < BEGIN + after, START, own.target)
    displacement[BEGIN + after : BEGIN + after + 10] += beyond
    return displacement


@pytest.mark.parametrize("amplitude", [20.0, -20.0])
def test_a_step_settles_when_it_arrives_and_overshoots(amplitude: float) -> None:
    own = scenario(amplitude)
    assert figures_of(own) == Figures(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, None, 0)
    late = figures_of(own, arriving(own, 150))
    assert late.settling_s == pytest.approx(1.5)
    assert late.iae == pytest.approx(20.0 * 1.5)
    assert late.rmse == pytest.approx(np.sqrt(400 * 150 / 400))
    assert late.overshoot == 0
    beyond = figures_of(own, arriving(own, 150, np.sign(amplitude) * 3.0))
    assert (beyond.overshoot, beyond.settling_s) == pytest.approx((3.0, 1.6))


def test_only_steps_settle_and_small_ones_within_less() -> None:
    still = figures_of(scenario(0.0))
    assert (still.overshoot, still.settling_s) == (None, None)
    for amplitude, settled in ((5.0, 1.6), (20.0, 1.5)):
        own = scenario(amplitude)
        assert figures_of(own, arriving(own, 150, 1.5)).settling_s == pytest.approx(settled)


def test_a_loop_outside_at_the_end_never_settles() -> None:
    own = scenario()
    assert figures_of(own, own.target + 2.1).settling_s == np.inf
    assert figures_of(own, own.target + 1.9).settling_s == 0
    broken = own.target.copy()
    broken[-1] = np.nan
    diverged = figures_of(own, broken, own.target)
    assert (diverged.diverged, diverged.settling_s) == (1, np.inf)


def test_final_error_is_the_mean_of_the_last_second() -> None:
    own = scenario()
    measured = own.target.copy()
    measured[:-100] += 7.0
    measured[-100:] += np.where(np.arange(100) % 2, 0.4, -0.2)
    measured[-1] = np.nan
    expected = abs(0.4 * 49 - 0.2 * 50) / 99
    assert figures_of(own, measured=[measured]).final_error == pytest.approx(expected)


def test_figures_of_many_loops_are_those_of_95_percent() -> None:
    own = scenario()
    figures = figures_of(own, *(own.target + error for error in np.linspace(0.0, 1.0, 101)))
    assert (figures.rmse, figures.final_error, figures.iae) == pytest.approx((0.95, 0.95, 0.5 * 4.0))
    figures = figures_of(own, *(arriving(own, after) for after in range(1, 21)))
    assert figures.settling_s == pytest.approx(0.19)


def test_valves_are_counted_that_open_and_both_on() -> None:
    currents = np.zeros((1, SAMPLES, 2))
    currents[0, 100:120, 0] = currents[0, 200:210, 0] = 0.5
    currents[0, 115:140, 1] = 0.4
    figures = figures_of(scenario(), currents=currents)
    assert figures.both_valves_samples == 5
    assert figures.valve_actions_per_10_s == pytest.approx(6.0)


@pytest.mark.parametrize("still_on", [0, 1, 4])
def test_samples_until_closed_are_those_with_current_after_the_loss(still_on: int) -> None:
    lost = np.zeros(SAMPLES, bool)
    lost[200:250] = True
    own = scenario(surroundings=Surroundings(sensor_lost=lost))
    currents = np.zeros((2, SAMPLES, 2))
    currents[:, 150:200, 0] = 0.5
    currents[1, 200 : 200 + still_on, 0] = 0.5
    figures = figures_of(own, own.target, own.target, currents=currents)
    assert figures.samples_until_closed == still_on


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
