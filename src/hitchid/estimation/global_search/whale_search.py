"""Whale optimisation as a global search of a problem."""

from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid._support.progress import IterationCallback
from hitchid.estimation.global_search import whale
from hitchid.estimation.global_search.search import (
    EVALUATIONS,
    Search,
    SearchResult,
    SearchStopReason,
    checked,
)
from hitchid.estimation.search_problem import SearchProblem

REPORT_INTERVAL = 5  # generations between two calls of the callback


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
        carry, draws = whale.begin(problem.dimensions, self.config, seed)
        last_generation = self.config.generations
        for until in range(
            REPORT_INTERVAL if callback else last_generation,
            last_generation + REPORT_INTERVAL,
            REPORT_INTERVAL,
        ):
            carry = _run_until(
                problem.fitness, carry, self.config, draws, jnp.asarray(min(until, last_generation))
            )
            if callback is not None:
                callback(int(carry[0].generation), float(carry[0].best_fitness))
            if until >= last_generation or bool(whale.stagnated(carry[0], self.config)):
                break
        outcome = whale.outcome(carry, self.config)
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


_run_until = eqx.filter_jit(whale.run_until)
