"""Whale optimisation: a swarm that encircles, spirals around and wanders from its best member.

Mirjalili & Lewis 2016, Advances in Engineering Software 95, 51-67. The search runs in the unit cube, one
compiled program for the whole population and every iteration.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hitchid._support.progress import IterationCallback
from hitchid.errors import InputError
from hitchid.estimation.search_problem import FitnessFunction, SearchProblem
from hitchid.estimation.searches import EVALUATIONS, Search, SearchResult, SearchStopReason, checked


@dataclass(frozen=True)
class WhaleConfig:
    """Settings of the swarm.

    Attributes:
        population: whales.
        iterations: generations evaluated, the first random one included.
        evaluations: largest number of objective evaluations, None for as many as the iterations take.
        stagnation: generations without a relative improvement of `tolerance` after which to stop, None never.
        tolerance: relative improvement that counts.
        per_dimension: draw A, C, p and l for each coordinate; False draws one of each for a whale, as older
            codes do, which restricts its moves.
        spiral: the constant b of the logarithmic spiral.
    """

    population: int = 30
    iterations: int = 100
    evaluations: int | None = None
    stagnation: int | None = None
    tolerance: float = 1e-6
    per_dimension: bool = True
    spiral: float = 1.0

    def __post_init__(self) -> None:
        """Raise InputError for settings that do not allow one generation."""
        if self.population < 2 or self.iterations < 1:
            raise InputError(
                f"whale: expected at least 2 whales and 1 iteration, got {self.population} "
                f"and {self.iterations}"
            )
        if self.evaluations is not None and self.evaluations < self.population:
            raise InputError(
                f"whale: expected at least {self.population} evaluations (one generation), got "
                f"{self.evaluations}"
            )

    @property
    def generations(self) -> int:
        """Generations that iterations and budget allow."""
        if self.evaluations is None:
            return self.iterations
        return min(self.iterations, self.evaluations // self.population)


class WhaleState(eqx.Module):
    """The swarm between two generations; the best fitness is +inf while none was finite.

    `improved` is the generation that last improved by more than the tolerance.
    """

    population: Float[Array, "p d"]
    best: Float[Array, " d"]
    best_fitness: Float[Array, ""]
    generation: Int[Array, ""]
    improved: Int[Array, ""]


class WhaleTrace(eqx.Module):
    """The whole search, one row a generation; rows past `generations` are unused and hold +inf.

    The fitness of every whale is +inf for a failed simulation; `best` is in the unit cube.
    """

    best_fitness: Float[Array, " g"]
    best: Float[Array, "g d"]
    fitness: Float[Array, "g p"]
    failures: Int[Array, " g"]


class WhaleResult(eqx.Module):
    """Result of a search: the best position in the unit cube, and whether stagnation ended the search."""

    best: Float[Array, " d"]
    best_fitness: Float[Array, ""]
    generations: Int[Array, ""]
    stagnated: Array
    trace: WhaleTrace


def init(rng: np.random.Generator, dimensions: int, config: WhaleConfig) -> WhaleState:
    """Return a swarm spread evenly at random over the unit cube."""
    population = jnp.asarray(rng.random((config.population, dimensions)))
    return WhaleState(
        population=population,
        best=jnp.asarray(np.array(population)[0]),
        best_fitness=jnp.asarray(np.inf, population.dtype),
        generation=jnp.asarray(0),
        improved=jnp.asarray(0),
    )


class WhaleDraws(NamedTuple):
    """Random numbers of moves, those of generations along a first axis; K is D, or one for all coordinates.

    A is drawn from −1 to 1, C from 0 to 2, l from −1 to 1; `member` is which whale X_r is.
    """

    a: Float[Array, "*g p k"]
    c: Float[Array, "*g p k"]
    spirals: Bool[Array, "*g p k"]
    spiral_parameter: Float[Array, "*g p k"]
    member: Int[Array, "*g p"]


def draw(rng: np.random.Generator, dimensions: int, config: WhaleConfig) -> WhaleDraws:
    """Return the random numbers of all generations' moves."""
    generations, population = config.generations, config.population
    shape = (generations, population, dimensions if config.per_dimension else 1)
    return WhaleDraws(
        a=jnp.asarray(rng.uniform(-1.0, 1.0, shape)),
        c=jnp.asarray(rng.uniform(0.0, 2.0, shape)),
        spirals=jnp.asarray(rng.random(shape) >= 0.5),
        spiral_parameter=jnp.asarray(rng.uniform(-1.0, 1.0, shape)),
        member=jnp.asarray(rng.integers(0, population, (generations, population))),
    )


def ask(draws: WhaleDraws, state: WhaleState, config: WhaleConfig) -> Float[Array, "p d"]:
    """Return where the whales move next; the first generation stays where it was put.

    X' = X* − A |C X* − X| where |A| < 1, X' = X_r − A |C X_r − X| with a random member r elsewhere, and with
    probability ½ the spiral X' = |X* − X| e^(b l) cos 2π l + X*; A = 2 a r₁ − a, C = 2 r₂, a from 2 to 0.
    Mirjalili & Lewis 2016, eq. 2.1-2.8. Whales are stopped at the walls of the cube.
    """
    shrink = 2.0 * (1.0 - state.generation / max(1, config.generations))
    a, spiral_parameter = shrink * draws.a, draws.spiral_parameter
    target = jnp.where(jnp.abs(a) < 1.0, state.best, state.population[draws.member])
    encircling = target - a * jnp.abs(draws.c * target - state.population)
    spiral_factor = jnp.exp(config.spiral * spiral_parameter) * jnp.cos(2.0 * jnp.pi * spiral_parameter)
    spiralling = jnp.abs(state.best - state.population) * spiral_factor + state.best
    moved_population = jnp.clip(jnp.where(draws.spirals, spiralling, encircling), 0.0, 1.0)
    return jnp.where(state.generation == 0, state.population, moved_population)


def tell(
    state: WhaleState, population: Float[Array, "p d"], fitness: Float[Array, " p"], config: WhaleConfig
) -> WhaleState:
    """Return the state updated by the fitness of a generation; a fitness that is not finite is +inf."""
    finite = jnp.where(jnp.isfinite(fitness), fitness, jnp.inf)
    leader = jnp.argmin(finite)
    better = finite[leader] < state.best_fitness
    gain = jnp.where(jnp.isfinite(state.best_fitness), state.best_fitness - finite[leader], jnp.inf)
    significant = better & (gain > config.tolerance * jnp.abs(finite[leader]))
    return WhaleState(
        population=population,
        best=jnp.where(better, population[leader], state.best),
        best_fitness=jnp.where(better, finite[leader], state.best_fitness),
        generation=state.generation + 1,
        improved=jnp.where(significant | (state.generation == 0), state.generation, state.improved),
    )


def begin(
    dimensions: int, config: WhaleConfig, seed: int
) -> tuple[tuple[WhaleState, WhaleTrace], WhaleDraws]:
    """Return a swarm before its first generation with an empty trace, and what all its moves draw.

    NumPy draws the random numbers: a compiled generator of them takes longer to compile than an objective.
    """
    generations, rng = config.generations, np.random.default_rng(seed)
    empty = WhaleTrace(
        best_fitness=jnp.asarray(np.full(generations, np.inf)),
        best=jnp.asarray(np.zeros((generations, dimensions))),
        fitness=jnp.asarray(np.full((generations, config.population), np.inf)),
        failures=jnp.asarray(np.zeros(generations, np.int32)),
    )
    return (init(rng, dimensions, config), empty), draw(rng, dimensions, config)


def whale_result(carry: tuple[WhaleState, WhaleTrace], config: WhaleConfig) -> WhaleResult:
    """Return what a swarm has found so far."""
    state, trace = carry
    return WhaleResult(state.best, state.best_fitness, state.generation, stagnated(state, config), trace)


def stagnated(state: WhaleState, config: WhaleConfig) -> Array:
    """Return whether the swarm has not improved by more than its tolerance for too long, shape []."""
    if config.stagnation is None:
        return jnp.asarray(False)
    return state.generation - 1 - state.improved >= config.stagnation


def run_until(
    objective: FitnessFunction,
    carry: tuple[WhaleState, WhaleTrace],
    config: WhaleConfig,
    draws: WhaleDraws,
    until: Int[Array, ""] | int,
) -> tuple[WhaleState, WhaleTrace]:
    """Run the swarm until a number of generations or until it stagnates.

    The objective is NaN where a simulation failed; where calls part the search changes nothing.
    """

    def unfinished(carry: tuple[WhaleState, WhaleTrace]) -> Array:
        state, _ = carry
        return (state.generation < until) & ~stagnated(state, config)

    def generation(carry: tuple[WhaleState, WhaleTrace]) -> tuple[WhaleState, WhaleTrace]:
        state, trace = carry
        row = state.generation
        population = ask(jax.tree.map(lambda drawn: drawn[row], draws), state, config)
        fitness = objective(population)
        state = tell(state, population, fitness, config)
        failed = ~jnp.isfinite(fitness)
        trace = WhaleTrace(
            best_fitness=trace.best_fitness.at[row].set(state.best_fitness),
            best=trace.best.at[row].set(state.best),
            fitness=trace.fitness.at[row].set(jnp.where(failed, jnp.inf, fitness)),
            failures=trace.failures.at[row].set(jnp.sum(failed, dtype=jnp.int32)),
        )
        return state, trace

    return jax.lax.while_loop(unfinished, generation, carry)


# Whale optimisation as a global search of a problem.

REPORT_INTERVAL = 5  # generations between two calls of the callback


@dataclass(frozen=True)
class Whale(Search):
    """Whale optimisation, the search of Sun et al. 2025, sec. 2.4.2.

    Attributes:
        config: settings of the swarm.
    """

    config: WhaleConfig = field(default_factory=lambda: WhaleConfig(evaluations=EVALUATIONS))
    name: str = field(default="whale", init=False)

    def minimise(
        self, problem: SearchProblem, seed: int, callback: IterationCallback | None = None
    ) -> SearchResult:
        """Search with a swarm of whales, in one compiled program."""
        carry, draws = begin(problem.dimensions, self.config, seed)
        last_generation = self.config.generations
        first = REPORT_INTERVAL if callback else last_generation
        for until in range(first, last_generation + REPORT_INTERVAL, REPORT_INTERVAL):
            stop = jnp.asarray(min(until, last_generation))
            carry = _run_until(problem.fitness, carry, self.config, draws, stop)
            if callback is not None:
                callback(int(carry[0].generation), float(carry[0].best_fitness))
            if until >= last_generation or bool(stagnated(carry[0], self.config)):
                break
        outcome = whale_result(carry, self.config)
        generations = int(outcome.generations)
        reason = SearchStopReason.ITERATIONS
        if bool(outcome.stagnated):
            reason = SearchStopReason.STAGNATION
        elif self.config.generations < self.config.iterations:
            reason = SearchStopReason.BUDGET
        return checked(
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


_run_until = eqx.filter_jit(run_until)
