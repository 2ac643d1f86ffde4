"""The problem that searches and least squares solve: fitness and normal equations over the unit cube."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from hitchid._support.records import short_repr

FitnessFunction = Callable[[Float[Array, "p d"]], Float[Array, " p"]]


class NormalEquations(NamedTuple):
    """The sum of squared residuals at a position, to second order as Gauss and Newton have it.

    Attributes:
        cost: ‖r‖².
        gradient: Jᵀ r, shape [D].
        curvature: Jᵀ J, shape [D, D].
    """

    cost: float
    gradient: Float[np.ndarray, " d"]
    curvature: Float[np.ndarray, "d d"]

    @property
    def finite(self) -> bool:
        """Whether every number is finite."""
        return bool(
            np.isfinite(self.cost) and np.isfinite(self.gradient).all() and np.isfinite(self.curvature).all()
        )

    def subset(self, columns: np.ndarray) -> "NormalEquations":
        """Return the equations of some of the parameters, by index."""
        return NormalEquations(self.cost, self.gradient[columns], self.curvature[np.ix_(columns, columns)])


@short_repr
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
