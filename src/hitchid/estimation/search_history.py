"""Histories of several searches on one budget, each from several seeds."""

from dataclasses import dataclass, field
from functools import partial

import jax
import numpy as np

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.files import digest
from hitchid._support.jax_setup import installed_versions
from hitchid._support.records import short_repr
from hitchid.errors import FitError
from hitchid.estimation.correlations import search_problem
from hitchid.estimation.objective import Objective
from hitchid.estimation.search_problem import SearchProblem
from hitchid.estimation.searches import DifferentialEvolution, MultiStart, Search
from hitchid.estimation.whale import Whale, WhaleConfig

BUDGET = 600  # simulations of all tests for each run; chosen
SEEDS = 8  # runs of each search; chosen
SAMPLES = 256  # largest number of samples of a test, which keeps a comparison within seconds


@short_repr
@dataclass(frozen=True)
class SearchRun:
    """One search from one seed.

    Attributes:
        fitness: best root mean square error so far, an entry an iteration (for multi-start a start); None
            while none was finite.
        values: the parameters that gave it, an entry an iteration.
        evaluations, failures: simulations of all tests that were run, and how many of them were not finite.
        reason: why it stopped.
    """

    fitness: tuple[float | None, ...]
    values: tuple[tuple[float, ...], ...]
    evaluations: int
    failures: int
    reason: str

    @property
    def final_fitness(self) -> float | None:
        """The fitness it ended with; None where it failed."""
        return self.fitness[-1] if self.fitness else None


@short_repr
@dataclass(frozen=True)
class SearchHistory:
    """One search from several seeds.

    Attributes:
        name: of the search.
        runs: one for each seed.
    """

    name: str
    runs: tuple[SearchRun, ...]

    @property
    def final_fitnesses(self) -> np.ndarray:
        """The last fitness of each run, shape [S], infinite for one that failed."""
        return np.array([np.inf if run.final_fitness is None else run.final_fitness for run in self.runs])


def default_searches(budget: int = BUDGET) -> tuple[Search, ...]:
    """Return the three searches, each with so many evaluations."""
    population = WhaleConfig.population
    config = WhaleConfig(population=population, iterations=budget // population, evaluations=budget)
    return Whale(config), DifferentialEvolution(budget, population=3), MultiStart(budget)


@dataclass(frozen=True)
class SearchComparison:
    """Settings of a comparison of searches.

    Attributes:
        searches: what is compared; by default whale, differential evolution and multi-start least squares.
        seeds: how many runs of each.
        checkpoints: where finished runs are kept and read back.
    """

    searches: tuple[Search, ...] = field(default_factory=default_searches)
    seeds: int = SEEDS
    checkpoints: Checkpoints = DISABLED


def compare_searches(
    objective: Objective, comparison: SearchComparison, first_seed: int = 0
) -> tuple[SearchHistory, ...]:
    """Run several searches of one objective from several seeds, without least squares after them.

    All work on the tests thinned to a few hundred samples each, so that they can be compared in seconds.

    Args:
        objective: what is searched.
        comparison: searches, number of seeds, and store of finished runs.
        first_seed: of each search; the others follow.
    """
    coarse = objective.with_data(objective.batch.decimate(SAMPLES))
    arrays = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(coarse))
    shapes = [(leaf.shape, str(leaf.dtype)) for leaf in map(np.asarray, jax.tree.leaves(coarse))]
    stamp = f"{digest(arrays)} {shapes} {coarse.batch.step_s} {coarse.batch.sign} {objective.spec!r}"
    stamp += f" {objective.per_test_gain} {installed_versions()}"
    problem = search_problem(coarse)
    histories = []
    for search in comparison.searches:
        runs = []
        for seed in range(first_seed, first_seed + comparison.seeds):
            name = digest(f"{stamp} {search!r} {seed}".encode())
            run = partial(_run, coarse, problem, search, seed)
            shapes = {"fitness": ("g",), "values": ("g", "d")}
            stored = comparison.checkpoints.cached(name, _StoredRun, run, shapes)
            runs.append(
                SearchRun(
                    tuple(value if np.isfinite(value) else None for value in stored.fitness.tolist()),
                    tuple(tuple(row) for row in stored.values.tolist()),
                    stored.evaluations,
                    stored.failures,
                    stored.reason,
                )
            )
        histories.append(SearchHistory(search.name, tuple(runs)))
    return tuple(histories)


@dataclass(frozen=True)
class _StoredRun:
    """A run in arrays: fitness, shape [G], not finite while none was; values, shape [G, D]."""

    fitness: np.ndarray
    values: np.ndarray
    evaluations: int
    failures: int
    reason: str


def _run(objective: Objective, problem: SearchProblem, search: Search, seed: int) -> _StoredRun:
    try:
        result = search.minimise(problem, seed)
    except FitError as error:
        return _StoredRun(np.zeros(0), np.zeros((0, 0)), 0, 0, str(error))
    return _StoredRun(
        result.fitness_trace,
        objective.values(result.best_trace),
        result.evaluations,
        result.failures,
        result.reason,
    )
