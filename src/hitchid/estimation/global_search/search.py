"""What every global search shares: its settings' protocol, its result, the record of the best position."""

import abc
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from hitchid._support.progress import IterationCallback
from hitchid._support.short_repr import short_repr
from hitchid.errors import FitError
from hitchid.estimation.search_problem import SearchProblem

EVALUATIONS = 3000  # simulations of all tests, the default budget of a search


class SearchStopReason(Enum):
    """Why a search stopped, with what to try."""

    ITERATIONS = "all iterations were run; more of them may still improve the fit"
    BUDGET = "the budget of evaluations was spent; a larger one may still improve the fit"
    STAGNATION = "the best fitness no longer improved; the search has settled"
    FAILED = "no position gave a finite error; widen or move the bounds"


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
