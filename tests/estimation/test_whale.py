"""Whale optimisation: what it reaches, what it counts, when it stops."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.estimation import whale
from hitchid.estimation.whale import WhaleConfig

OPTIMUM = np.array([0.31, 0.83, 0.17])
TURN, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
SEEDS = 10


def search_of(objective, dimensions, swarm):
    """Return a compiled search of a swarm to its end, from a seed."""

    @jax.jit
    def run(carry, draws):
        return whale.whale_result(whale.run_until(objective, carry, swarm, draws, swarm.generations), swarm)

    return lambda seed: run(*whale.begin(dimensions, swarm, seed))


def sphere(positions):
    return jnp.sum((positions - OPTIMUM) ** 2, axis=-1)


def rotated_ellipsoid(positions):
    return jnp.sum(jnp.array([1.0, 10.0, 100.0]) * ((positions - OPTIMUM) @ TURN.T) ** 2, axis=-1)


def rosenbrock(positions):
    x, y = jnp.moveaxis(1.0 + 4.0 * (positions - OPTIMUM[:2]), -1, 0)
    return 100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2


@pytest.mark.parametrize(
    ("objective", "dimensions", "factor"), [(rotated_ellipsoid, 3, 100.0), (rosenbrock, 2, 20.0)]
)
def test_whales_leave_random_search_far_behind_wherever_the_optimum_lies(objective, dimensions, factor):
    # The volume in which a quadratic misfit is below f goes with f^(D/2): to come as low, random search
    # would need 100^1.5 = 1000 times the budget in three dimensions, 20 times in two.
    swarm = WhaleConfig(population=30, iterations=100)
    search = search_of(objective, dimensions, swarm)
    reached = np.array([search(seed).best_fitness for seed in range(SEEDS)])
    points = np.random.default_rng(0).uniform(size=(101, 3000, dimensions))
    by_chance = np.median(np.asarray(objective(jnp.asarray(points))).min(axis=1))
    assert np.count_nonzero(reached * factor <= by_chance) >= 8


POSITIONS, FITNESS = [], []


@cache
def compiled(objective, swarm):
    """Return a search that leaves all it evaluates in POSITIONS and FITNESS."""

    def keep(positions, fitness):
        POSITIONS.append(np.array(positions))
        FITNESS.append(np.array(fitness))

    def logging(positions):
        fitness = objective(positions)
        jax.debug.callback(keep, positions, fitness, ordered=True)
        return fitness

    return search_of(logging, 3, swarm)


def logged(objective, swarm, *, seed=0):
    """Return a search's outcome, and the positions and fitness it evaluated, shape [G, P, 3] and [G, P]."""
    POSITIONS.clear()
    FITNESS.clear()
    outcome = compiled(objective, swarm)(seed)
    jax.effects_barrier()
    return outcome, np.array(POSITIONS), np.array(FITNESS)


def half_failing(positions):
    """Fall toward the corner, and fail within 0.4 of the wall there: the best would be a failure."""
    return jnp.where(positions[:, 0] < 0.4, jnp.nan, jnp.sum(positions, axis=-1))


def test_the_outcome_is_the_best_of_everything_that_was_evaluated():
    swarm = WhaleConfig(population=8, iterations=15)
    outcome, positions, fitness = logged(rotated_ellipsoid, swarm)
    assert positions.shape == (15, 8, 3)
    np.testing.assert_array_equal(outcome.trace.fitness, fitness)
    flat = int(np.argmin(fitness))
    assert outcome.best_fitness == fitness.ravel()[flat]
    np.testing.assert_array_equal(outcome.best, positions.reshape(-1, 3)[flat])
    np.testing.assert_array_equal(outcome.trace.best_fitness, np.minimum.accumulate(fitness.min(axis=1)))
    assert int(outcome.generations) == 15
    assert not bool(outcome.stagnated)


def test_a_failed_simulation_is_counted_and_never_best():
    outcome, _, fitness = logged(half_failing, WhaleConfig(population=8, iterations=15))
    failed = np.isnan(fitness)
    assert 0 < failed.sum() < failed.size
    np.testing.assert_array_equal(outcome.trace.failures, failed.sum(axis=1))
    np.testing.assert_array_equal(np.isinf(outcome.trace.fitness), failed)
    assert float(outcome.best[0]) >= 0.4
    assert float(outcome.best_fitness) == np.nanmin(fitness)
    assert not np.isnan(outcome.trace.best_fitness).any()


@pytest.mark.parametrize(
    ("evaluations", "generations"), [(8, 1), (40, 5), (47, 5), (48, 6), (1000, 10), (None, 10)]
)
def test_no_more_generations_fit_than_iterations_and_budget_allow(evaluations, generations):
    assert WhaleConfig(population=8, iterations=10, evaluations=evaluations).generations == generations


@pytest.mark.parametrize("setting", [{"evaluations": 7}, {"population": 1}, {"iterations": 0}])
def test_a_swarm_that_cannot_run_is_refused(setting):
    with pytest.raises(InputError, match="whale: expected"):
        WhaleConfig(**{"population": 8, "iterations": 10, **setting})


@pytest.mark.parametrize("level", [-3.0, np.nan])
def test_stagnation_ends_the_search_early_and_says_so(level):
    swarm = WhaleConfig(population=4, iterations=30, stagnation=6)
    outcome, positions, _ = logged(lambda positions: positions[:, 0] * 0 + level, swarm)
    # The first generation is the last to improve; six more without improvement follow it.
    assert int(outcome.generations) == len(positions) == 7
    assert bool(outcome.stagnated)
    assert np.all(np.isposinf(outcome.trace.best_fitness[7:]))


def test_drawing_once_for_a_whale_moves_otherwise():
    wide, _, _ = logged(sphere, WhaleConfig(population=8, iterations=5))
    narrow, _, _ = logged(sphere, WhaleConfig(population=8, iterations=5, per_dimension=False))
    np.testing.assert_array_equal(wide.trace.fitness[0], narrow.trace.fitness[0])
    assert np.all(np.asarray(wide.trace.fitness[1:]) != np.asarray(narrow.trace.fitness[1:]))


WIDE = WhaleConfig(population=6, iterations=20)
ask = eqx.filter_jit(whale.ask)


@given(seed=st.integers(0, 2**20), generation=st.integers(0, 20), corner=st.sampled_from([0.0, 0.5, 1.0]))
def test_whales_stay_in_the_cube(seed, generation, corner):
    rng = np.random.default_rng(seed)
    state = whale.init(rng, 3, WIDE)
    state = eqx.tree_at(
        lambda s: (s.best, s.generation), state, (jnp.full(3, corner), jnp.asarray(generation))
    )
    for swarm in (WIDE, WhaleConfig(6, 20, per_dimension=False)):
        draws = jax.tree.map(lambda drawn: drawn[0], whale.draw(rng, 3, swarm))
        moved = ask(draws, state, swarm)
        assert np.all((np.asarray(moved) >= 0.0) & (np.asarray(moved) <= 1.0))
        if generation == 0:
            np.testing.assert_array_equal(moved, state.population)
        else:
            assert np.any(np.asarray(moved) != np.asarray(state.population))


@pytest.mark.parametrize("stagnation", [None, 4])
def test_a_search_looked_at_ends_where_it_would_have(stagnation):
    swarm = WhaleConfig(population=6, iterations=20, stagnation=stagnation, tolerance=0.05)
    carry, draws = whale.begin(3, swarm, 4)
    proceed = jax.jit(lambda carry, until: whale.run_until(sphere, carry, swarm, draws, until))
    at_once = search_of(sphere, 3, swarm)(4)
    for stops in ((7, 20), (1, 2, 3, 20), (20,)):
        carry, _ = whale.begin(3, swarm, 4)
        for until in stops:
            carry = proceed(carry, jnp.asarray(until))
        result = whale.whale_result(carry, swarm)
        for one, other in zip(jax.tree.leaves(result), jax.tree.leaves(at_once), strict=True):
            np.testing.assert_array_equal(one, other)
