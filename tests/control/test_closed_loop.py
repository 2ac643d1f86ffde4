"""Closed loops on the virtual bench: any controller, what acts on the bench, and what is refused."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid.bench import load_rig, simulate
from hitchid.control.closed_loop import Surroundings, measured_at_rest, run_closed_loops
from hitchid.errors import InputError

SAMPLES, START = 150, 120.0
TARGET = START + np.where(np.arange(SAMPLES) < 20, 0.0, 6.0)
FACTORS = np.array([1.0, 1.3])
LOST = (np.arange(SAMPLES) >= 60) & (np.arange(SAMPLES) < 80)


@dataclass(frozen=True)
class Plain:
    """A controller of plain numbers around a traced one."""

    controller: object

    def initial_state(self, displacement_mm):
        return self.controller.initial_state(displacement_mm)

    def step(self, state, target_mm, measured_mm):
        assert type(measured_mm) is float
        state, currents = self.controller.step(state, target_mm, measured_mm)
        return state, [float(current) for current in currents]


class Returning:
    """A controller that returns always the same."""

    def __init__(self, currents):
        self.currents = currents

    def initial_state(self, displacement_mm):
        return None

    def step(self, state, target_mm, measured_mm):
        return state, self.currents


class TracedReturning(eqx.Module):
    """A controller that JAX can trace and that returns always the same."""

    currents: jax.Array

    def initial_state(self, displacement_mm):
        return jnp.zeros(())

    def step(self, state, target_mm, measured_mm):
        return state, self.currents


def closed(controller, *, factors=FACTORS, target=TARGET, **surroundings):
    return run_closed_loops(
        controller,
        load_rig("nominal"),
        jax.random.key(3),
        target,
        start_mm=START,
        implement_factors=factors,
        surroundings=Surroundings(**surroundings),
    )


@pytest.fixture(scope="module")
def traced(brisk):
    """Return the loops of a traced controller."""
    return closed(brisk)


def test_the_bench_follows_its_target(traced) -> None:
    assert traced.displacement.shape == traced.measured.shape == (2, SAMPLES)
    assert traced.commands.shape == (2, SAMPLES, 2)
    np.testing.assert_allclose(traced.time_s, 0.01 * np.arange(SAMPLES))
    np.testing.assert_allclose(traced.displacement[:, 0], START, atol=1e-6)
    assert np.all(traced.displacement[:, -1] > START + 3.0)
    assert np.abs(traced.measured - traced.displacement).max() < 2.0


def test_a_controller_of_plain_numbers_gives_the_same_signals(traced, brisk) -> None:
    for signal, same in zip(closed(Plain(brisk)), traced, strict=True):
        np.testing.assert_allclose(signal, same, rtol=0, atol=1e-6)


def test_a_held_hitch_is_measured_as_its_sensor_reads(traced) -> None:
    """The loops hold for 20 samples first; the means of 100 and of 40 readings differ by their noise."""
    held = traced.measured[:, :20]
    measured = measured_at_rest(load_rig("nominal"), jax.random.key(5), START, 100)
    assert measured == pytest.approx(held.mean(), abs=5 * held.std() / np.sqrt(30))


def test_each_loop_has_the_noise_of_the_key(brisk) -> None:
    first, again = closed(brisk, factors=np.ones(2)), closed(brisk, factors=np.ones(2))
    np.testing.assert_array_equal(first.measured, again.measured)
    assert np.any(first.measured[0] != first.measured[1])


def test_the_mass_of_the_implement_changes_the_motion(traced, brisk) -> None:
    other = closed(brisk, factors=np.array([1.0, 0.7]))
    np.testing.assert_array_equal(other.displacement[0], traced.displacement[0])
    assert np.abs(other.displacement[1] - traced.displacement[1]).max() > 1e-3


def test_a_lost_sensor_measures_nothing_and_closes_the_valves(brisk) -> None:
    loops = closed(brisk, sensor_lost=LOST)
    np.testing.assert_array_equal(np.isnan(loops.measured), np.tile(LOST, (2, 1)))
    assert np.any(loops.commands[:, LOST.argmax() - 1] > 0)
    assert np.all(loops.commands[np.isnan(loops.measured)] == 0)
    assert np.all(np.isfinite(loops.displacement))


@pytest.mark.parametrize(
    ("name", "oil_c"), [("heavy-cold", None), ("light-warm-worn", None), ("nominal", 5.0)]
)
def test_a_loop_runs_on_the_bench_of_the_campaigns(name: str, oil_c) -> None:
    rig, currents = load_rig(name), jnp.array([0.8, 0.0])
    closed_loop = run_closed_loops(
        TracedReturning(currents),
        rig,
        jax.random.key(0),
        TARGET,
        start_mm=START,
        implement_factors=np.ones(1),
        surroundings=Surroundings(oil_c=oil_c),
    )
    open_loop = simulate(
        rig,
        np.tile(np.asarray(currents), (1, SAMPLES, 1)),
        initial_displacement_m=1e-3 * START,
        oil_temperature_c=oil_c,
    )
    expected_mm = 1e3 * np.asarray(open_loop.displacement_m)
    assert np.ptp(expected_mm) > 5.0
    np.testing.assert_allclose(closed_loop.displacement, expected_mm, rtol=0, atol=1e-6)


def test_a_growing_leak_lets_a_held_hitch_sink_faster() -> None:
    idle = TracedReturning(jnp.zeros(2))
    worn = np.where(np.arange(SAMPLES) < 75, 1.0, 20.0)
    sound = closed(idle).displacement
    leaking = closed(idle, leakage_factor=worn).displacement
    np.testing.assert_array_equal(leaking[:, :76], sound[:, :76])
    assert np.all(leaking[:, -1] < sound[:, -1] - 0.01)


@pytest.mark.parametrize("change_a", [-0.05, 0.05])
def test_a_worn_dead_zone_shifts_the_current_of_a_speed(change_a: float) -> None:
    """The opening is that of i/i_s − i₀/i_s over 1 − i₀/i_s: a longer dead zone slows the same current."""
    driven = TracedReturning(jnp.array([0.8, 0.0]))
    same, changed = closed(driven), closed(driven, dead_zone_change_a=change_a)
    travel = [loops.displacement[:, -1] - START for loops in (same, changed)]
    assert np.all(np.sign(travel[0] - travel[1]) == np.sign(change_a))


def test_cold_oil_and_soil_change_the_motion(traced, brisk) -> None:
    cold = closed(brisk, oil_c=5.0)
    soil = closed(brisk, surface_mm=START + 40.0, soil_n_per_mm=np.full(SAMPLES, 80.0))
    for other in (cold, soil):
        assert np.all(np.isfinite(other.displacement))
        assert np.abs(other.displacement - traced.displacement).max() > 1e-3


@pytest.mark.parametrize("currents", [[0.1, 0.2, 0.3], [0.1], 0.5, None, "off", [[0.1, 0.2]]])
def test_other_than_two_currents_are_refused(currents) -> None:
    with pytest.raises(InputError, match="controller: expected two currents"):
        closed(Returning(currents), factors=np.ones(1))


def test_three_currents_of_a_traced_controller_are_refused() -> None:
    with pytest.raises(InputError, match=r"currents.*\(3,\)"):
        closed(TracedReturning(jnp.array([0.1, 0.2, 0.3])), factors=np.ones(1))


def test_a_start_beyond_the_stroke_is_refused(brisk) -> None:
    with pytest.raises(InputError):
        run_closed_loops(
            brisk, load_rig("nominal"), jax.random.key(0), TARGET, start_mm=5000.0, implement_factors=FACTORS
        )
