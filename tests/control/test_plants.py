"""Plants from elsewhere, in any units: their scenarios, their loops, and a whole drive."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.control import run_plant_loops
from hitchid.control.drive import TESTED, drive
from hitchid.control.drive_report import drive_report
from hitchid.control.scenarios import Kind, plant_scenarios
from hitchid.errors import InputError

STEP_S = 0.01


class Boom:
    """A boom that moves by 0.5 deg/s for each percent."""

    def reset(self, displacement, seed):
        return displacement, displacement

    def step(self, state, commands):
        state = state + 0.5 * STEP_S * (commands[0] - commands[1])
        return state, state


class Proportional:
    """A controller that commands 2 percent for each degree."""

    def initial_state(self, displacement):
        return None

    def step(self, state, target, measured):
        error = 0.0 if np.isnan(measured) else 2.0 * (target - measured)
        return state, (max(error, 0.0), max(-error, 0.0))


class Delayed(eqx.Module):
    """An integrator behind a dead zone of 0.3 A, 20 mm/(s·A)."""

    def reset(self, displacement, seed):
        return jnp.asarray(displacement), jnp.asarray(displacement)

    def step(self, state, commands):
        opened = jnp.maximum(commands - 0.3, 0.0)
        state = state + 20 * STEP_S * (opened[0] - opened[1])
        return state, state


def test_a_plain_plant_decays_as_its_difference_equation() -> None:
    target = np.full(100, 11.0)
    loops = run_plant_loops(Proportional(), Boom(), 0, target, start=10.0, loops=2)
    error = (1 - 0.5 * STEP_S * 2.0) ** np.arange(100)  # deg
    np.testing.assert_allclose(loops.displacement, np.tile(11.0 - error, (2, 1)), rtol=1e-12)
    np.testing.assert_allclose(loops.commands[0, :, 0], 2.0 * error, rtol=1e-10)


def test_a_lost_sensor_is_lost_to_the_controller_only() -> None:
    lost = np.arange(60) >= 30
    loops = run_plant_loops(
        Proportional(), Boom(), 0, np.full(60, 11.0), start=10.0, loops=1, sensor_lost=lost
    )
    assert np.all(np.isfinite(loops.measured))
    assert np.all((loops.commands[0] > 0).any(axis=1) == ~lost)


def test_a_plant_that_measures_no_number_is_refused() -> None:
    class Silent(Boom):
        def step(self, state, commands):
            return state, None

    with pytest.raises(InputError, match="expected a number as its measurement; got None"):
        run_plant_loops(Proportional(), Silent(), 0, np.full(5, 11.0), start=10.0, loops=1)


@pytest.mark.parametrize(("lowest", "highest", "slowest"), [(-30.0, 35.0, 12.0), (0.0, 250.0, 16.0)])
def test_scenarios_stay_within_the_travel_and_speed_of_a_plant(lowest, highest, slowest) -> None:
    scenarios = plant_scenarios(lowest, highest, slowest, "deg")
    for scenario in scenarios:
        assert lowest < scenario.target.min() <= scenario.target.max() < highest
        if scenario.kind in (Kind.RAMP, Kind.SINE):
            assert np.abs(np.diff(scenario.target)).max() / STEP_S < slowest
        if scenario.amplitude:
            assert 0 < scenario.tolerance < abs(scenario.amplitude)
    assert "step +5 deg" in {scenario.name for scenario in scenarios}


def test_a_plant_without_its_travel_is_refused(linear_controller) -> None:
    with pytest.raises(InputError, match="travel"):
        drive(linear_controller, Boom())


@pytest.mark.long
def test_a_drive_of_a_plant_says_its_unit(brisk) -> None:
    result = drive(brisk, Delayed(), travel=(0.0, 200.0), units=("deg", "percent"), draws=1)
    assert result.metrics["both_valves_samples"] == 0
    assert result.metrics["unit"] == "deg"
    assert all(np.isfinite(own.settling_s) for own in result.figures[TESTED].values() if own.settling_s)
    document = drive_report(result, rig="plant own:plant", margins={})
    assert "IAE / deg·s" in document.tables[0].header
