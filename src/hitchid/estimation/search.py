"""Global searches of the unit cube on one budget of evaluations, and the least-squares polish."""

import abc
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import differential_evolution

from hitchid._support.progress import IterationCallback
from hitchid.errors import FitError, InputError
from hitchid.estimation import whale
from hitchid.estimation.least_squares import NormalEquations, StopReason, minimise
from hitchid.estimation.whale import FitnessFunction

EVALUATIONS, REPORT_INTERVAL = 3000, 5


@dataclass(frozen=True)
class SearchProblem:
    """What is minimised: the root mean square of residuals over the unit cube.

    Attributes:
        dimensions: D.
        fitness: from positions of shape [P, D] to fitness of shape [P], fit for jit; as a module it is
            compiled once for all searches over tests of one shape.
        samples: M, how many residuals there are.
        normal_equations: of the residuals at a position of shape [D], compiled.
    """

    dimensions: int
    fitness: FitnessFunction
    samples: int
    normal_equations: Callable[[np.ndarray], NormalEquations]


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
            callback: told the best error after a round, or after some.

        Raises:
            FitError: no position gave a finite error.
            InputError: the budget does not allow one round.
        """


@dataclass(frozen=True)
class Whale(Search):
    """Whale optimisation, the search of Sun et al. 2025, sec. 2.4.2.

    Attributes:
        config: settings of the swarm.
    """

    config: whale.WhaleConfig = field(default_factory=lambda: whale.WhaleConfig(evaluations=EVALUATIONS))
    name: str = field(default="whale", init=False)

    def minimise(
        self, problem: SearchProblem, seed: int, callback: IterationCallback | None = None
    ) -> SearchResult:
        """Search with a swarm of whales, in one compiled program."""
        key = jax.random.key(seed)
        carry = _begin(problem.dimensions, self.config, key)
        last_generation = self.config.generations
        for until in range(
            REPORT_INTERVAL if callback else last_generation,
            last_generation + REPORT_INTERVAL,
            REPORT_INTERVAL,
        ):
            carry = _run_until(
                problem.fitness, carry, self.config, key, jnp.asarray(min(until, last_generation))
            )
            if callback is not None:
                callback(int(carry[0].generation), float(carry[0].best_fitness))
            if until >= last_generation or bool(whale.stagnated(carry[0], self.config)):
                break
        outcome = whale.outcome(carry, self.config)
        generations = int(outcome.generations)
        reason = whale.SearchStopReason.ITERATIONS
        if bool(outcome.stagnated):
            reason = whale.SearchStopReason.STAGNATION
        elif self.config.generations < self.config.iterations:
            reason = whale.SearchStopReason.BUDGET
        return _checked(
            SearchResult(
                best=np.asarray(outcome.best),
                best_fitness=float(outcome.best_fitness),
                evaluations=generations * self.config.population,
                failures=int(np.sum(outcome.trace.failures)),
                reason=reason.value,
                fitness_trace=np.asarray(outcome.trace.best_fitness)[:generations],
                best_trace=np.asarray(outcome.trace.best)[:generations],
            )
        )


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
        best: list[np.ndarray] = []
        trace: list[float] = []
        simulated = failures = 0

        def generation(positions: np.ndarray) -> np.ndarray:
            nonlocal simulated, failures
            population = np.atleast_2d(positions.T)
            simulated += len(population)
            fitness = np.asarray(_evaluate(problem.fitness, jnp.asarray(population)))
            failures += int(np.sum(~np.isfinite(fitness)))
            fitness = np.where(np.isfinite(fitness), fitness, np.inf)
            leader = int(np.argmin(fitness))
            improved = not trace or fitness[leader] < trace[-1]
            best.append(population[leader] if improved else best[-1])
            trace.append(float(fitness[leader]) if improved else trace[-1])
            if callback is not None:
                callback(len(trace), trace[-1])
            return fitness

        members = self.population * problem.dimensions
        if self.evaluations < 2 * members:
            raise InputError(
                f"differential evolution: required evaluations for two generations of {members} members, "
                f"came {self.evaluations}"
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
        return _checked(
            SearchResult(
                best=best[-1],
                best_fitness=trace[-1],
                evaluations=simulated,
                failures=failures,
                reason=whale.SearchStopReason.BUDGET.value,
                fitness_trace=np.array(trace),
                best_trace=np.array(best),
            )
        )


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
        best: list[np.ndarray] = []
        trace: list[float] = []
        spent = failures = 0
        while spent < self.evaluations and (self.starts is None or len(trace) < self.starts):
            start = points.random(1)[0]
            per_round = 1 + problem.dimensions
            try:
                local = refine(problem, start, limit=max(1, (self.evaluations - spent - 1) // per_round))
            except FitError:
                failures += 1
                spent += per_round
                continue
            spent += local.evaluations
            improved = not trace or local.fitness < trace[-1]
            best.append(local.position if improved else best[-1])
            trace.append(local.fitness if improved else trace[-1])
            if callback is not None:
                callback(len(trace), trace[-1])
        all_starts_run = self.starts is not None and len(trace) == self.starts
        reason = whale.SearchStopReason.ITERATIONS if all_starts_run else whale.SearchStopReason.BUDGET
        return _checked(
            SearchResult(
                best=best[-1] if best else np.zeros(problem.dimensions),
                best_fitness=trace[-1] if trace else np.inf,
                evaluations=spent,
                failures=failures,
                reason=reason.value,
                fitness_trace=np.array(trace),
                best_trace=np.array(best).reshape(-1, problem.dimensions),
            )
        )


@dataclass(frozen=True)
class LeastSquaresResult:
    """Where least squares ended.

    Attributes:
        position: in the unit cube, shape [D].
        fitness: root mean square of the residuals.
        evaluations: simulations of all tests, a Jacobian counting one for each dimension.
        reason: why it stopped.
    """

    position: np.ndarray
    fitness: float
    evaluations: int
    reason: StopReason


def refine(
    problem: SearchProblem, start: np.ndarray, *, limit: int = 200, tolerance: float = 1e-14
) -> LeastSquaresResult:
    """Descend from a position to the bottom of its valley by bounded nonlinear least squares; see `minimise`.

    Args:
        problem: what to minimise.
        start: a position in the unit cube.
        limit: largest number of positions, the start included.
        tolerance: relative change of fitness or position below which to stop.

    Raises:
        FitError: the residuals at the start or their derivative are not finite.
    """
    minimum = minimise(problem.normal_equations, start, limit=limit, tolerance=tolerance)
    if minimum is None:
        raise FitError("the simulation failed at the start of the least squares; narrow the bounds")
    return LeastSquaresResult(
        position=minimum.position,
        fitness=float(np.sqrt(minimum.equations.cost / problem.samples)),
        evaluations=minimum.steps * (1 + problem.dimensions),
        reason=minimum.reason,
    )


def best_refined(
    problem: SearchProblem, starts: Iterable[np.ndarray], *, limit: int, tolerance: float
) -> LeastSquaresResult:
    """Return the best of several least squares; a start that cannot be simulated counts for nothing.

    Raises:
        FitError: none of the starts can be simulated.
    """
    results, failure = [], FitError("least squares: required at least one start, came none")
    for start in starts:
        try:
            results.append(refine(problem, start, limit=limit, tolerance=tolerance))
        except FitError as error:
            failure = error
    if not results:
        raise failure
    return min(results, key=lambda result: result.fitness)


_begin = eqx.filter_jit(whale.begin)
_run_until = eqx.filter_jit(whale.run_until)


@eqx.filter_jit
def _evaluate(fitness: FitnessFunction, population: Float[Array, "p d"]) -> Float[Array, " p"]:
    return fitness(population)


def _checked(result: SearchResult) -> SearchResult:
    if not np.isfinite(result.best_fitness):
        raise FitError(
            f"{whale.SearchStopReason.FAILED.value} ({result.evaluations} evaluations, all failed)"
        )
    return result
