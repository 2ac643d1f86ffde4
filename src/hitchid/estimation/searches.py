"""What every global search shares: its settings' protocol, its result, the record of the best position."""

import abc
from dataclasses import dataclass, field
from enum import Enum

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import differential_evolution

from hitchid._support.progress import IterationCallback
from hitchid._support.records import short_repr
from hitchid.errors import FitError, InputError
from hitchid.estimation.least_squares import refine
from hitchid.estimation.search_problem import FitnessFunction, SearchProblem

EVALUATIONS = 3000  # simulations of all tests, the default budget of a search


class SearchStopReason(Enum):
    """Why a search stopped, with what to try."""

    ITERATIONS = "the maximum number of iterations was reached; more may improve the fit"
    BUDGET = "the maximum number of evaluations was reached; more may improve the fit"
    STAGNATION = "converged: the best fitness no longer improved"
    FAILED = "no parameter vector gave a finite error; change the bounds"


@short_repr
@dataclass(frozen=True)
class SearchResult:
    """What a search found.

    Attributes:
        best: position in the unit cube, shape [D].
        best_fitness: root mean square of the residuals there.
        evaluations: simulations of all tests that were run.
        failures: how many of them were not finite.
        reason: why the search stopped, with what to try.
        fitness_trace: best fitness so far, an entry a generation or start, shape [G].
        best_trace: its position, shape [G, D].
    """

    best: np.ndarray
    best_fitness: float
    evaluations: int
    failures: int
    reason: str
    fitness_trace: np.ndarray
    best_trace: np.ndarray


class Search(abc.ABC):
    """A global search; `name` is how settings and reports call it."""

    name: str

    @abc.abstractmethod
    def minimise(
        self, problem: SearchProblem, seed: int, callback: IterationCallback | None = None
    ) -> SearchResult:
        """Search the unit cube.

        Args:
            problem: what is minimised.
            seed: every random draw comes from it.
            callback: called with the best error after a round, or after some.

        Raises:
            FitError: no position gave a finite error.
            InputError: the budget does not allow one round.
        """


@dataclass
class BestSoFar:
    """Record of the best position of a search, an entry a generation or start.

    Attributes:
        callback: called with the number of entries and the best fitness after each.
        positions, fitness: the best so far.
    """

    callback: IterationCallback | None
    positions: list[np.ndarray] = field(default_factory=list)
    fitness: list[float] = field(default_factory=list)

    def add(self, position: np.ndarray, fitness: float) -> None:
        """Add the best of a generation or start."""
        improved = not self.fitness or fitness < self.fitness[-1]
        self.positions.append(position if improved else self.positions[-1])
        self.fitness.append(fitness if improved else self.fitness[-1])
        if self.callback is not None:
            self.callback(len(self.fitness), self.fitness[-1])

    def result(
        self, dimensions: int, *, evaluations: int, failures: int, reason: SearchStopReason
    ) -> SearchResult:
        """Return the result of the search.

        Raises:
            FitError: no position gave a finite error.
        """
        return checked(
            SearchResult(
                best=self.positions[-1] if self.positions else np.zeros(dimensions),
                best_fitness=self.fitness[-1] if self.fitness else np.inf,
                evaluations=evaluations,
                failures=failures,
                reason=reason.value,
                fitness_trace=np.array(self.fitness),
                best_trace=np.array(self.positions).reshape(-1, dimensions),
            )
        )


def checked(result: SearchResult) -> SearchResult:
    """Return a result; raises FitError where no position gave a finite error."""
    if not np.isfinite(result.best_fitness):
        raise FitError(f"{SearchStopReason.FAILED.value} ({result.evaluations} evaluations, all failed)")
    return result


# Differential evolution as a global search of a problem.


@dataclass(frozen=True)
class DifferentialEvolution(Search):
    """Differential evolution as `scipy.optimize` has it.

    Attributes:
        evaluations: largest number of simulations of all tests.
        population: members for each dimension.
    """

    evaluations: int = EVALUATIONS
    population: int = 10
    name: str = field(default="differential-evolution", init=False)

    def minimise(
        self, problem: SearchProblem, seed: int, callback: IterationCallback | None = None
    ) -> SearchResult:
        """Search by differential evolution, a generation at a time."""
        best = BestSoFar(callback)
        simulated = failures = 0

        def generation(positions: np.ndarray) -> np.ndarray:
            nonlocal simulated, failures
            population = np.atleast_2d(positions.T)
            simulated += len(population)
            fitness = np.asarray(_evaluate(problem.fitness, jnp.asarray(population)))
            failures += int(np.sum(~np.isfinite(fitness)))
            fitness = np.where(np.isfinite(fitness), fitness, np.inf)
            leader = int(np.argmin(fitness))
            best.add(population[leader], float(fitness[leader]))
            return fitness

        members = self.population * problem.dimensions
        if self.evaluations < 2 * members:
            raise InputError(
                f"differential evolution: expected at least {2 * members} evaluations (two generations), "
                f"got {self.evaluations}"
            )
        differential_evolution(
            generation,
            [(0.0, 1.0)] * problem.dimensions,
            popsize=self.population,
            maxiter=self.evaluations // members - 1,
            tol=0.0,
            atol=0,
            polish=False,
            vectorized=True,
            updating="deferred",
            rng=np.random.default_rng(seed),
        )
        return best.result(
            problem.dimensions, evaluations=simulated, failures=failures, reason=SearchStopReason.BUDGET
        )


@eqx.filter_jit
def _evaluate(fitness: FitnessFunction, population: Float[Array, "p d"]) -> Float[Array, " p"]:
    return fitness(population)


# Least squares from many starting points as a global search of a problem.


@dataclass(frozen=True)
class MultiStart(Search):
    """Least squares from many starting points spread as a Sobol' sequence.

    Attributes:
        evaluations: largest number of simulations of all tests; a Jacobian counts as one for each dimension.
        starts: largest number of starting points, None for as many as the budget allows.
    """

    evaluations: int = EVALUATIONS
    starts: int | None = None
    name: str = field(default="multi-start", init=False)

    def minimise(
        self, problem: SearchProblem, seed: int, callback: IterationCallback | None = None
    ) -> SearchResult:
        """Run least squares from one start after the other until the budget is spent."""
        from scipy.stats import qmc  # not at the top: a quarter of a second

        points = qmc.Sobol(problem.dimensions, rng=np.random.default_rng(seed))
        best = BestSoFar(callback)
        spent = failures = 0
        while spent < self.evaluations and (self.starts is None or len(best.fitness) < self.starts):
            start = points.random(1)[0]
            per_round = 1 + problem.dimensions
            try:
                local = refine(problem, start, limit=max(1, (self.evaluations - spent - 1) // per_round))
            except FitError:
                failures += 1
                spent += per_round
                continue
            spent += local.evaluations
            best.add(local.position, local.fitness)
        all_starts_run = self.starts is not None and len(best.fitness) == self.starts
        reason = SearchStopReason.ITERATIONS if all_starts_run else SearchStopReason.BUDGET
        return best.result(problem.dimensions, evaluations=spent, failures=failures, reason=reason)
