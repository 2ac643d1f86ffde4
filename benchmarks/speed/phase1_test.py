"""Phase 1 of lifting, 30 whales and 100 iterations, beside mealpy over an objective on lfilter."""

import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lfilter_whale import MEALPY, Lifting, evaluate
from lfilter_whale import search as mealpy_search
from lifting import many_tests, objective_of, save, search, search_by_simulation
from search_process import ITERATIONS, SEED, WHALES
from timings import OURS, process

from hitchid.estimation import search_problem
from hitchid.estimation.search_problem import FitnessFunction
from hitchid.identification.preparation import prepare
from hitchid.logs import read
from hitchid.logs.record import LIFTING
from hitchid.structures import Batch

TIMES = 100
WARM = "search of 3000 evaluations, in memory, warm"
WHOLE = "search of 3000 evaluations, whole process, programs compiled before"
SIMULATING = f"{OURS}, every evaluation simulated"


@pytest.fixture(scope="module")
def batch(rig_a) -> Batch:
    """Return the identification tests of lifting."""
    return prepare(read(rig_a), LIFTING, None).all_tests


@pytest.fixture(scope="module")
def tests(batch, tmp_path_factory) -> Path:
    """Return the file both processes read."""
    path = tmp_path_factory.mktemp("phase1") / "lifting.npz"
    save(batch, path)
    return path


@pytest.fixture(scope="module")
def lifting(tests) -> Lifting:
    """Return the tests as the peer has them."""
    return Lifting.load(tests)


def population(seed: int = 0) -> np.ndarray:
    """Return a swarm anywhere between the bounds, shape [30, 3]."""
    return np.random.default_rng(seed).uniform(0.0, 1.0, (WHALES, 3))


def test_both_minimise_the_same(batch, lifting):
    """Simulated, from correlations and by lfilter, J is the same."""
    objective, positions = objective_of(batch), population()
    peer_values = evaluate(lifting, positions)
    np.testing.assert_allclose(peer_values, objective(jnp.asarray(positions)), rtol=1e-6)
    np.testing.assert_allclose(
        peer_values, search_problem(objective).fitness(jnp.asarray(positions)), rtol=1e-6
    )


def test_our_search(timed, batch):
    """Our search, warm, from the tests in memory to the best parameters."""
    timed(lambda: search(batch, SEED, WHALES, ITERATIONS), WARM, slow=True)


def test_our_search_by_simulation(timed, batch):
    """The same where every evaluation simulates every test, which is what the peer does."""
    timed(lambda: search_by_simulation(batch, SEED, WHALES, ITERATIONS), WARM, SIMULATING, slow=True)


def test_mealpy_search(timed, lifting):
    """The peer's search, from the tests in memory to the best parameters."""
    timed(lambda: mealpy_search(lifting, SEED, WHALES, ITERATIONS), WARM, MEALPY, slow=True)


def test_both_find_the_same(batch, lifting):
    """Ours finds nothing worse, so that no time is bought with quality."""
    ours = search(batch, SEED, WHALES, ITERATIONS)
    np.testing.assert_array_less(ours, 1.001 * mealpy_search(lifting, SEED, WHALES, ITERATIONS))


def test_mealpy_evaluates_as_often(lifting, monkeypatch):
    """As many evaluations are made by the peer."""
    calls = []
    monkeypatch.setattr(Lifting, "error", lambda *_: calls.append(1) or 1.0)
    mealpy_search(lifting, SEED, WHALES, ITERATIONS)
    np.testing.assert_equal(len(calls), WHALES * ITERATIONS)


def test_searches_as_processes(tally, tests, pace, tmp_path):
    """Both searches as whole processes, our compiled programs in the user's cache from a run before."""
    script = Path(__file__).with_name("search_process.py")

    def run(by: str) -> None:
        process([sys.executable, script, by, tests], tmp_path)

    run("hitchid")
    work = {OURS: lambda: run("hitchid"), MEALPY: lambda: run("mealpy")}
    tally.interleave(WHOLE, work, pace.runs, "both read the tests from one `.npz`")


@pytest.mark.parametrize("times", [1, TIMES])
def test_our_evaluation(timed, batch, times):
    """Thirty evaluations of ours over few tests and over many, once they are collected."""
    fitness = search_problem(objective_of(many_tests(batch, times, seed=0))).fitness
    positions = jnp.asarray(population())
    timed(lambda: np.asarray(compiled(fitness, positions)), evaluations(times))


@pytest.mark.parametrize("times", [1, TIMES])
def test_lfilter_evaluation(timed, batch, times, tmp_path):
    """The same by the peer's objective."""
    save(many_tests(batch, times, seed=0), tmp_path / "many.npz")
    tests, positions = Lifting.load(tmp_path / "many.npz"), population()
    timed(lambda: evaluate(tests, positions), evaluations(times), "lfilter", slow=times > 1)


def test_evaluation_of_more_tests(tally, batch, pace):
    """By how much an evaluation costs more with a hundred times the tests."""
    positions = jnp.asarray(population())
    fitness_few, fitness_many = (
        search_problem(objective_of(many_tests(batch, times, seed=0))).fitness for times in (1, TIMES)
    )
    work = {
        f"{OURS}, 1600 tests": lambda: np.asarray(compiled(fitness_many, positions)),
        f"{OURS}, 16 tests": lambda: np.asarray(compiled(fitness_few, positions)),
    }
    for call in work.values():
        call()
    tally.interleave("30 evaluations, 1600 tests beside 16", work, 20 * pace.runs)


def test_collecting_many_tests(timed, batch):
    """What is done once before a search of 1600 tests."""
    tests = many_tests(batch, TIMES, seed=0)
    timed(
        lambda: search_problem(objective_of(tests)),
        "made once of 1600 tests, before their first evaluation",
        slow=True,
    )


@eqx.filter_jit
def compiled(fitness: FitnessFunction, positions: jax.Array) -> jax.Array:
    """Return J at each position, in one compiled program."""
    return fitness(positions)


def evaluations(times: int) -> str:
    """Return how the page calls thirty evaluations."""
    return f"30 evaluations of J over {16 * times} tests"
