"""The error from correlations is that of simulating every test."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchid.estimation import Objective, search_problem
from hitchid.estimation.correlations import (
    MAX_SAMPLES,
    MAX_SAMPLES_PER_TEST,
    CorrelationObjective,
    correlations_applicable,
)
from hitchid.logs.record import LIFTING
from hitchid.structures import BUILT_IN, Batch, ModelSpec, discretise, pulse_response, structure_named
from hitchid.structures.discretisation import simulate_linear
from hitchid.structures.structure import LinearStructure
from truth import STEP_S, held, levels, second_order

LINEAR = [each for each in BUILT_IN if isinstance(each, LinearStructure) and not each.has_dry_friction]
# What the objective promises; sums of squares of some thousand samples round to far less.
RELATIVE = 1e-9


@pytest.fixture(scope="session")
def campaign(make_record):
    """Return a function that makes tests of unequal length of one noisy plant."""

    def make(tests, *, seed=0, samples=(120, 250), direction=1, end_stop=None, noise=0.3):
        rng = np.random.default_rng(seed)
        records = []
        for _ in range(tests):
            command = levels(rng, int(rng.integers(*samples)), low=0.2)
            travel = held(*second_order(20.0, 9.0, 0.5), command, STEP_S)
            shown = travel if end_stop is None else np.minimum(travel, end_stop)
            records.append(
                make_record(80.0 + direction * (shown + noise * rng.standard_normal(shown.size)), command)
            )
        stop = None if end_stop is None else 80.0 + direction * end_stop
        return Batch.of(records, LIFTING, dead_zone=0.0, sign=direction, end_stop=stop)

    return make


@eqx.filter_jit
def evaluated(fitness, positions):
    return fitness(positions)


def errors(misfit, positions):
    """Return J at positions from correlations and by simulation."""
    problem = search_problem(misfit)
    assert isinstance(problem.fitness, CorrelationObjective)
    return np.asarray(evaluated(problem.fitness, positions)), np.asarray(evaluated(misfit, positions))


@pytest.mark.parametrize("structure", LINEAR, ids=lambda structure: structure.name)
def test_error_is_that_of_simulating_every_test(campaign, structure):
    misfit = Objective.of(campaign(5), ModelSpec(structure, dead_time=True))
    positions = jnp.asarray(np.random.default_rng(1).random((40, len(misfit.spec.parameters))))
    collected, simulated = errors(misfit, positions)
    np.testing.assert_allclose(collected, simulated, rtol=RELATIVE)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), direction=st.sampled_from([1, -1]), stop=st.booleans())
def test_end_stops_and_folds_leave_samples_out(campaign, seed, direction, stop):
    batch = campaign(6, seed=seed, direction=direction, end_stop=12.0 if stop else None)
    rng = np.random.default_rng(seed)
    kept = rng.random(6) < 0.7
    kept[rng.integers(6)] = True
    shape = batch.loss_mask.shape
    misfit = Objective.of(batch, ModelSpec(structure_named("integrator-second-order")))
    misfit = misfit.with_data(batch.masked(jnp.asarray(np.broadcast_to(kept[:, None], shape))))
    collected, simulated = errors(misfit, jnp.asarray(rng.random((10, 3))))
    np.testing.assert_allclose(collected, simulated, rtol=RELATIVE)


def test_many_tests_collect_to_what_few_do(campaign):
    few = campaign(3)
    many = few.take([0, 1, 2] * 40)
    form = ModelSpec(structure_named("integrator-second-order"))
    positions = jnp.asarray(np.random.default_rng(2).random((10, 3)))
    once, often = (
        np.asarray(evaluated(search_problem(Objective.of(batch, form)).fitness, positions))
        for batch in (few, many)
    )
    np.testing.assert_allclose(often, once, rtol=RELATIVE)


@pytest.mark.parametrize(("samples", "dead_time_s"), [(2, 0.003), (37, 0.0), (256, 0.147), (256, 3.1)])
def test_pulse_response_is_the_simulated_answer_to_one_sample(samples, dead_time_s):
    structure = structure_named("integrator-second-order")
    model = discretise(structure, jnp.array([20.0, 9.0, 0.3]), dead_time_s, STEP_S)
    pulse = jnp.zeros((1, samples)).at[0, 0].set(1.0)
    expected = np.asarray(simulate_linear(model, pulse))[0]
    # Powers of Φ are multiplied in another order: some rounding each of N times.
    bound = samples * np.finfo(float).eps * max(float(np.abs(expected).max()), 1e-300)
    np.testing.assert_allclose(pulse_response(model, samples), expected, atol=bound, rtol=0)


def test_curves_holes_and_few_long_tests_are_simulated(campaign):
    structure = structure_named("integrator-second-order")
    curved = Objective.of(campaign(4), ModelSpec(structure, valve_curve=True))
    assert isinstance(search_problem(curved).fitness, Objective)
    longest = 2 * MAX_SAMPLES_PER_TEST + 1
    assert longest + 1 < MAX_SAMPLES
    assert not correlations_applicable(campaign(2, samples=(longest, longest + 1)))
    assert correlations_applicable(campaign(4, samples=(longest, longest + 1)))
    # Samples that count after others that do not.
    holes = jnp.asarray(np.arange(curved.batch.loss_mask.shape[1]) % 7 != 3)[None]
    assert not correlations_applicable(curved.batch.masked(holes))
