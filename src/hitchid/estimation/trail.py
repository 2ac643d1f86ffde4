"""The trail of a search: several searches on one budget, each from several seeds, step by step."""

from dataclasses import dataclass, field
from functools import partial

import jax
import numpy as np

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid._support.storage import digest
from hitchid._support.versions import installed_versions
from hitchid.errors import FitError
from hitchid.estimation.misfit import Misfit
from hitchid.estimation.search import DifferentialEvolution, Found, MultiStart, Problem, Search, Whale
from hitchid.estimation.searchable import searchable
from hitchid.estimation.whale import Swarm

BUDGET = 600
SEEDS = 8
SAMPLES = 256


@dataclass(frozen=True)
class Run:
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
    def last(self) -> float | None:
        """The fitness it ended with; None where it failed."""
        return self.fitness[-1] if self.fitness else None


@dataclass(frozen=True)
class Trail:
    """One search from several seeds.

    Attributes:
        name: of the search.
        runs: one for each seed.
    """

    name: str
    runs: tuple[Run, ...]

    @property
    def ends(self) -> np.ndarray:
        """The last fitness of each run, shape [S], infinite for one that failed."""
        return np.array([each if each is not None else np.inf for each in (run.last for run in self.runs)])


def three_searches(budget: int = BUDGET) -> tuple[Search, ...]:
    """Return the three searches, each with so many evaluations."""
    population = Swarm.population
    swarm = Swarm(population=population, iterations=budget // population, evaluations=budget)
    return Whale(swarm), DifferentialEvolution(budget, population=3), MultiStart(budget)


@dataclass(frozen=True)
class Comparison:
    """How searches are compared.

    Attributes:
        searches: what is compared; by default whale, differential evolution and multi-start least squares.
        seeds: how many runs of each.
        kept: where finished runs are kept and found again.
    """

    searches: tuple[Search, ...] = field(default_factory=three_searches)
    seeds: int = SEEDS
    kept: Checkpoints = NOWHERE


def search_trails(misfit: Misfit, asked: Comparison, first_seed: int = 0) -> tuple[Trail, ...]:
    """Run several searches of one misfit from several seeds, none of them polished.

    All work on the tests thinned to a few hundred samples each, so that they can be compared in seconds.

    Args:
        misfit: what is searched.
        asked: which, how many, and where they are kept.
        first_seed: of each search; the others follow.
    """
    thin = misfit.over(misfit.batch.thinned(SAMPLES))
    arrays = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(thin))
    shapes = [(leaf.shape, str(leaf.dtype)) for leaf in map(np.asarray, jax.tree.leaves(thin))]
    stamp = f"{digest(arrays)} {shapes} {thin.batch.step_s} {thin.batch.direction} {misfit.form!r}"
    stamp += f" {misfit.apart} {installed_versions()}"
    problem = searchable(thin)
    found = []
    for search in asked.searches:
        runs = []
        for seed in range(first_seed, first_seed + asked.seeds):
            name = digest(f"{stamp} {search!r} {seed}".encode())
            runs.append(_told(asked.kept.piece(name, _Searched, partial(_run, thin, problem, search, seed))))
        found.append(Trail(search.name, tuple(runs)))
    return tuple(found)


@dataclass(frozen=True)
class _Searched:
    """A run in arrays: fitness, shape [G], not finite while none was; values, shape [G, D]."""

    fitness: np.ndarray
    values: np.ndarray
    evaluations: int
    failures: int
    reason: str


def _run(misfit: Misfit, problem: Problem, search: Search, seed: int) -> _Searched:
    try:
        found: Found = search.minimise(problem, seed)
    except FitError as error:
        return _Searched(np.zeros(0), np.zeros((0, 0)), 0, 0, str(error))
    return _Searched(
        found.fitness_trace, misfit.values(found.best_trace), found.evaluations, found.failures, found.reason
    )


def _told(run: _Searched) -> Run:
    return Run(
        fitness=tuple(each if np.isfinite(each) else None for each in run.fitness.tolist()),
        values=tuple(tuple(each) for each in run.values.tolist()),
        evaluations=run.evaluations,
        failures=run.failures,
        reason=run.reason,
    )
