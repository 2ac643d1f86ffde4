"""Differential evolution as a global search of a problem."""

from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import differential_evolution

from hitchid._support.progress import IterationCallback
from hitchid.errors import InputError
from hitchid.estimation.global_search.search import (
    EVALUATIONS,
    BestSoFar,
    Search,
    SearchResult,
    SearchStopReason,
)
from hitchid.estimation.search_problem import FitnessFunction, SearchProblem


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
