"""A parameter whose interval holds only for another one at its bound is not called determined."""

import numpy as np
import pytest

from hitchid.estimation import Objective
from hitchid.structures import ModelSpec, Parameter, structure_named
from hitchid.uncertainty.intervals import assess
from hitchid.uncertainty.parameter_result import ParameterResult, over_values_of
from hitchid.uncertainty.profile import Profile
from truth import held, levels, second_order

FORM = ModelSpec(structure_named("integrator-second-order"))
SAMPLES, TESTS, NOISE = 200, 8, 0.05
LOWEST_DAMPING = 0.05  # bound of the search


@pytest.fixture
def estimates_at(batch_of):
    """Return a function that assesses estimates at a damping ratio, of a plant with another one."""

    def make(damping_ratio, *, plant):
        rng = np.random.default_rng(0)
        commands = [levels(rng, SAMPLES, low=0.2) for _ in range(TESTS)]
        travels = np.array([held(*second_order(20.0, 8.0, plant), command) for command in commands])
        travels += NOISE * rng.standard_normal(travels.shape)
        batch = batch_of(zip(commands, travels, strict=True), start=None)
        objective = Objective.of(batch, FORM)
        position = objective.position(np.array([20.0, 8.0, damping_ratio]))
        assessment, _ = assess(objective, position, units={"x": "mm", "u": "A"})
        return {estimate.name: estimate for estimate in assessment.parameters}

    return make


def test_a_frequency_with_damping_inside_bounds_is_determined(estimates_at):
    estimates = estimates_at(0.3, plant=0.3)
    assert all(estimate.verdict == "determined" for estimate in estimates.values())


def test_a_frequency_that_damping_hardly_moves_stays_determined(estimates_at):
    estimates = estimates_at(LOWEST_DAMPING, plant=0.01)
    assert not estimates["damping_ratio"].determined
    # Of a lightly damped oscillator the frequency shows in the period, whatever the damping.
    assert estimates["natural_frequency"].determined


FREQUENCY = Parameter("natural_frequency", "rad/s", 1.0, 100.0, symbol="ωh")
RATIO = Parameter("damping_ratio", "1", 0.05, 50.0, symbol="ξh")


def at_bound(frequencies, allowed):
    """Return a damping ratio at its lower bound: coordinates of the frequency along its profile."""
    positions = np.column_stack([frequencies, np.linspace(0.0, 0.4, len(frequencies))])
    flat, fixed = np.ones(len(frequencies)), np.zeros(positions.shape)
    curve = Profile(1, None, 0.2, positions, flat, np.array(allowed), fixed, search_range=1.0)
    return ParameterResult(1, RATIO, 0.05, 50.0, linear=False, bound="lower", profile=curve)


FOUND = ParameterResult(0, FREQUENCY, 1.0, 100.0, linear=False, bound="", interval=(9.0, 11.0))


def test_an_interval_covers_all_allowed_values_of_the_other():
    # Half of the unit interval is a factor of ten: 0.01 of it is 4.7 %.
    result = over_values_of(at_bound([0.5, 0.51, 0.9], [True, True, False]), FOUND, step=0.0)
    assert result.determined
    assert result.interval == pytest.approx((9.0, 11.0 * 100**0.01), rel=1e-12)


def test_a_parameter_that_follows_another_is_conditional_on_it():
    result = over_values_of(at_bound([0.5, 0.8], [True, True]), FOUND, step=0.0)
    assert not result.determined
    assert result.conditional_on == ("ξh",)
    assert result.interval == (9.0, 11.0)


@pytest.mark.parametrize(("step", "determined"), [(-0.02, True), (0.03, True), (0.3, False), (-0.3, False)])
def test_an_interval_covers_the_unbounded_estimate_or_is_conditional(step, determined):
    # From 10 to 11 is ln 1.1 / ln 100 = 0.0207 of the unit interval, to 9 it is 0.0229; a factor of three,
    # the widest interval of a determined parameter, is 0.2386.
    result = over_values_of(at_bound([0.5, 0.5], [True, True]), FOUND, step=step)
    assert result.determined is determined
