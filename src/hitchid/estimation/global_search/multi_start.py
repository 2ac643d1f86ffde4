"""Least squares from many starting points as a global search of a problem."""

from dataclasses import dataclass, field

import numpy as np

from hitchid._support.progress import IterationCallback
from hitchid.errors import FitError
from hitchid.estimation.global_search.search import (
    EVALUATIONS,
    BestSoFar,
    Search,
    SearchResult,
    SearchStopReason,
)
from hitchid.estimation.least_squares import refine
from hitchid.estimation.search_problem import SearchProblem


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
