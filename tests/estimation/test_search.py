"""One protocol over every global search, and the least-squares polish."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import FitError, InputError
from hitchid.estimation import SearchProblem, refine
from hitchid.estimation.least_squares import StopReason
from hitchid.estimation.search_problem import NormalEquations
from hitchid.estimation.whale import WhaleConfig
from hitchid.identification import DifferentialEvolution, MultiStart, Whale

OPTIMUM = np.array([0.31, 0.83, 0.17])
ROWS = np.random.default_rng(0).normal(size=(12, 3))
# Orthogonal to every column, so that it adds to the misfit and leaves the minimum where it is.
REST = np.linalg.svd(ROWS)[0][:, -1]


def shifted_quadratic(positions):
    """Return residuals A (x − x*) + r with Aᵀ r = 0: the minimum is at x*, its height |r|/√12."""
    return (positions - OPTIMUM) @ ROWS.T + 1e-3 * REST


HEIGHT = 1e-3 / np.sqrt(12)


def equations(residuals, jacobian):
    return NormalEquations(float(residuals @ residuals), jacobian.T @ residuals, jacobian.T @ jacobian)


class Counter:
    """A problem that counts the positions it simulates, a Jacobian as one for each dimension."""

    def __init__(self, fails_beyond=2.0):
        self.simulated = self.failed = 0
        self.asked = []
        self.fails_beyond = fails_beyond

    def problem(self):
        return SearchProblem(3, fitness_failing_beyond(self.fails_beyond), 12, self._normal_equations)

    def count(self, positions):
        self.asked.append(np.array(positions))
        failed = np.array(positions)[..., 0] > self.fails_beyond
        self.simulated += failed.size
        self.failed += int(failed.sum())

    def _normal_equations(self, position):
        self.count(position)
        self.simulated += 3
        residuals = np.where(position[0] > self.fails_beyond, np.nan, shifted_quadratic(position))
        return equations(residuals, ROWS)

    def run(self, search, seed=0):
        COUNTING[:] = [self]
        result = search.minimise(self.problem(), seed)
        jax.effects_barrier()
        return result


COUNTING: list[Counter] = []


@cache
def fitness_failing_beyond(limit):
    """Return one and the same function for one limit, so that it is compiled once."""

    def fitness(positions):
        jax.debug.callback(lambda asked: COUNTING[0].count(asked), positions, ordered=True)
        height = jnp.sqrt(jnp.mean(shifted_quadratic(positions) ** 2, axis=-1))
        return jnp.where(positions[:, 0] > limit, jnp.nan, height)

    return fitness


def whale(evaluations):
    return Whale(WhaleConfig(population=20, iterations=10**4, evaluations=evaluations))


def evolution(evaluations):
    return DifferentialEvolution(evaluations=evaluations, population=5)


def starts(evaluations):
    return MultiStart(evaluations=evaluations)


every_search = pytest.mark.parametrize("search", [whale, evolution, starts])


@every_search
def test_the_minimum_of_a_shifted_quadratic_is_found(search):
    result = Counter().run(search(1500))
    # Random search comes within 1500^(-1/3) = 0.09; a tenth of that is 1000 times its budget.
    assert np.abs(result.best - OPTIMUM).max() <= 0.009
    assert HEIGHT * (1 - 1e-12) <= result.best_fitness <= HEIGHT + 0.009 * np.linalg.norm(ROWS)


@every_search
@pytest.mark.parametrize("evaluations", [40, 333])
def test_no_more_is_simulated_than_the_budget_allows(search, evaluations):
    counter = Counter()
    result = counter.run(search(evaluations))
    assert result.evaluations == counter.simulated
    assert "maximum number of evaluations" in result.reason
    assert counter.simulated <= evaluations + 1 + 3
    # Nor is it left lying about: what remains would not pay for another generation or start.
    assert counter.simulated >= evaluations - 20


def test_a_budget_of_less_than_two_generations_is_refused():
    with pytest.raises(InputError, match=r"at least 30 evaluations.*29"):
        Counter().run(evolution(29))


@every_search
def test_the_trace_shows_the_best_so_far(search):
    result = Counter().run(search(333))
    assert result.fitness_trace.shape == result.best_trace.shape[:1]
    assert np.all(np.diff(result.fitness_trace) <= 0)
    assert result.fitness_trace[-1] == result.best_fitness
    np.testing.assert_array_equal(result.best_trace[-1], result.best)
    heights = np.sqrt(np.mean(shifted_quadratic(result.best_trace) ** 2, axis=1))
    np.testing.assert_allclose(result.fitness_trace, heights, rtol=1e-12)
    assert np.all((result.best_trace >= 0) & (result.best_trace <= 1))


@every_search
def test_one_seed_gives_one_search_and_another_seed_another(search):
    counters = [Counter() for _ in range(3)]
    one, again, _ = (
        counter.run(search(100), seed) for counter, seed in zip(counters, (5, 5, 6), strict=True)
    )
    np.testing.assert_array_equal(one.best_trace, again.best_trace)
    np.testing.assert_array_equal(one.fitness_trace, again.fitness_trace)
    assert one.evaluations == again.evaluations
    assert np.all(counters[0].asked[0] != counters[2].asked[0])


@every_search
def test_failures_are_counted_and_do_not_hide_the_minimum(search):
    counter = Counter(fails_beyond=0.5)
    result = counter.run(search(1500))
    assert np.abs(result.best - OPTIMUM).max() <= 0.009
    assert counter.failed > 0
    assert result.failures == counter.failed
    with pytest.raises(FitError, match="all failed"):
        Counter(fails_beyond=-1.0).run(search(100))


def test_whales_that_settled_and_starts_that_are_made_say_so():
    swarm = WhaleConfig(population=10, iterations=10**4, stagnation=5, tolerance=0.5)
    result = Counter().run(Whale(swarm))
    assert "converged" in result.reason
    assert result.evaluations == 10 * len(result.fitness_trace) < 1000
    result = Counter().run(MultiStart(evaluations=10**4, starts=3))
    assert len(result.fitness_trace) == 3
    assert "iterations" in result.reason


@given(
    start=st.lists(st.floats(0, 1), min_size=3, max_size=3),
    optimum=st.lists(st.floats(0.05, 0.95), min_size=3, max_size=3),
)
def test_polish_reaches_the_exact_minimum_from_anywhere(start, optimum):
    target = ROWS @ np.array(optimum) + 1e-3 * REST
    problem = SearchProblem(
        3, lambda positions: positions[:, 0], 12, lambda at: equations(ROWS @ at - target, ROWS)
    )
    best = refine(problem, np.array(start))
    exact = np.linalg.lstsq(ROWS, target, rcond=None)[0]
    # At a relative change of 1e-14 of the sum of squares h² + |A δ|², |A δ| is 1e-7 h, h = 1e-3.
    assert np.abs(best.position - exact).max() <= 1e-9
    assert best.fitness == pytest.approx(HEIGHT, rel=1e-12)
    assert best.reason is StopReason.CONVERGED


def test_polish_stops_at_the_wall():
    outside = np.array([1.4, 0.5, -0.3])
    problem = SearchProblem(
        3, lambda positions: positions[:, 0], 3, lambda at: equations(at - outside, np.eye(3))
    )
    best = refine(problem, np.array([0.4, 0.6, 0.5]))
    np.testing.assert_allclose(best.position, [1.0, 0.5, 0.0], atol=1e-7)


@pytest.mark.parametrize("broken", ["residuals", "derivative"])
def test_a_step_that_fails_is_shortened(broken):
    """r = log x − log 0.2 from x = 0.9: the full step goes beyond x = 0.15, where the simulation fails."""

    def failing(at):
        residuals, jacobian = np.log(at / 0.2), np.diag(1 / at)
        if at[0] < 0.15:
            residuals, jacobian = (
                (residuals * np.nan, jacobian) if broken == "residuals" else (residuals, jacobian * np.inf)
            )
        return equations(residuals, jacobian)

    best = refine(SearchProblem(1, lambda positions: positions[:, 0], 1, failing), np.array([0.9]))
    assert best.position[0] == pytest.approx(0.2, rel=1e-6)


def test_least_squares_that_can_step_nowhere_says_so():
    def failing(at):
        return equations(at - 2.0, np.eye(1)) if at[0] == 0.5 else equations(at * np.nan, np.eye(1))

    best = refine(SearchProblem(1, lambda positions: positions[:, 0], 1, failing), np.array([0.5]))
    assert best.reason is StopReason.NOT_FINITE
    assert best.position[0] == 0.5


@given(start=st.lists(st.floats(0, 1), min_size=2, max_size=2))
def test_rosenbrocks_valley_is_followed_to_its_end(start):
    """r = (10 (y − x²), 1 − x), x = 4 p − 2: the minimum is at (1, 1), curved and narrow on the way."""

    def valley(at):
        x, y = 4 * at - 2
        return equations(np.array([10 * (y - x**2), 1 - x]), 4 * np.array([[-20 * x, 10.0], [-1.0, 0.0]]))

    best = refine(SearchProblem(2, lambda positions: positions[:, 0], 2, valley), np.array(start))
    np.testing.assert_allclose(best.position, [0.75, 0.75], atol=1e-6)


def test_polish_refuses_a_start_that_cannot_be_simulated():
    counter = Counter(fails_beyond=0.5)
    with pytest.raises(FitError, match=r"at the start values .* infinite or NaN"):
        refine(counter.problem(), np.array([0.9, 0.5, 0.5]))


@pytest.mark.parametrize(
    "search",
    [
        Whale(WhaleConfig(population=6, iterations=23, evaluations=None)),
        DifferentialEvolution(evaluations=120, population=4),
        MultiStart(evaluations=80),
    ],
    ids=lambda search: search.name,
)
def test_a_watched_search_finds_the_same(search):
    steps = []
    counter = Counter()
    COUNTING[:] = [counter]
    watched = search.minimise(counter.problem(), 3, lambda number, error: steps.append((number, error)))
    alone = Counter().run(search, 3)
    np.testing.assert_array_equal(watched.best, alone.best)
    np.testing.assert_array_equal(watched.fitness_trace, alone.fitness_trace)
    numbers, errors = zip(*steps, strict=True)
    assert list(numbers) == sorted(set(numbers))
    assert numbers[-1] == watched.fitness_trace.size
    assert list(errors) == sorted(errors, reverse=True)
    assert errors[-1] == watched.best_fitness
