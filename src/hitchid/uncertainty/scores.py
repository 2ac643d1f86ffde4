"""What each test says of each parameter: slopes and curvatures of the squared misses, test by test."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid.estimation import Misfit

FEWEST = 4
LEAST = 0.05


class Scores(NamedTuple):
    """Slopes and curvatures of half the squared misses at one position, a row a test.

    Where there are fewer than four tests more than parameters, a row is one of several stretches of a test.

    Attributes:
        slopes: gₜ = Jₜᵀ rₜ, shape [T, D].
        curvatures: Jₜᵀ Jₜ, shape [T, D, D].
    """

    slopes: Float[np.ndarray, "t d"]
    curvatures: Float[np.ndarray, "t d d"]

    @classmethod
    def of(cls, misfit: Misfit, position: np.ndarray) -> "Scores":
        """Take slopes and curvatures of a misfit at a position in the unit cube."""
        moving = np.asarray(misfit.batch.counted).any(axis=1)
        if np.count_nonzero(moving) >= position.size + FEWEST:
            found = misfit.equations_by_test(position).take(np.flatnonzero(moving))
            return cls(found.slopes, found.curvatures)
        pieces = -(-(position.size + FEWEST) // int(np.count_nonzero(moving)))
        found = misfit.equations_by_stretch(position, pieces)
        return cls(found.slopes, found.curvatures)

    def over(self, free: np.ndarray) -> "Scores":
        """Return those of some of the parameters.

        Args:
            free: which, boolean, shape [D].
        """
        return Scores(self.slopes[:, free], self.curvatures[:, free][:, :, free])

    @property
    def curvature(self) -> Float[np.ndarray, "d d"]:
        """The sum over tests."""
        return self.curvatures.sum(axis=0)

    def along(self, number: int) -> Float[np.ndarray, " d"]:
        """Return how all parameters go where one goes by 1 and the others follow, −Hₒₒ⁻¹ Hₒᵢ, shape [D]."""
        others = np.arange(self.slopes.shape[1]) != number
        whole, along = self.curvature, np.ones(self.slopes.shape[1])
        along[others] = -np.linalg.pinv(whole[np.ix_(others, others)], hermitian=True) @ whole[others, number]
        return along

    def influence(self) -> Float[np.ndarray, "t d"]:
        """Return by how much each test moves the estimate, shape [T, D]: their squares sum to its variance.

        δₜ = −H⁻¹ Fₜ gₜ with Fₜ = (I − Hₜ H⁻¹)^(−½): the power makes up for what a test has pulled the
        estimate its own way (Bell & McCaffrey 2002, Survey Methodology 28, 169, CR2). Residuals of one test
        may be correlated in any way; tests are independent of each other.
        """
        inverse, freed = self._freed()
        return -np.einsum("tij,tj->ti", freed, self.slopes) @ inverse

    def degrees(self, combinations: Float[np.ndarray, "d q"] | None = None) -> Float[np.ndarray, " q"]:
        """Return the degrees of freedom of standard errors, shape [Q], at least one.

        (tr Ω)²/‖Ω‖² with Ωₜₛ = |pₜ|² [t = s] − qₜᵀ H⁻¹ qₛ, qₜ = Fₜ Hₜ H⁻¹ c, |pₜ|² = cᵀ H⁻¹ Fₜ qₜ, c the
        combination: tests count by their share of what is known (Bell & McCaffrey 2002, with white errors).

        Args:
            combinations: weights c of the parameters, shape [D, Q]; by default each parameter alone.
        """
        inverse, freed = self._freed()
        along = inverse if combinations is None else inverse @ combinations
        pulled = np.einsum("tij,tjk,kd->tid", freed, self.curvatures, along)
        sizes = np.einsum("id,tij,tjd->td", along, freed, pulled)
        together = np.einsum("tid,ij,sjd->dts", pulled, inverse, pulled)
        own = np.einsum("td,ts->dts", np.maximum(sizes, 0.0), np.eye(len(sizes)))
        spread = own - together
        trace = np.einsum("dtt->d", spread)
        return np.maximum(trace**2 / np.maximum(np.sum(spread**2, axis=(1, 2)), 1e-300), 1.0)

    def _freed(self) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, "t d d"]]:
        """Return H⁻¹ and each test's Fₜ."""
        inverse = np.linalg.pinv(self.curvature, hermitian=True)
        one = np.eye(len(inverse))
        return inverse, np.stack([_power(one - own @ inverse) for own in self.curvatures])


def _power(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse square root of I − P, whose eigenvalues lie between 0 and 1."""
    values, vectors = np.linalg.eig(matrix)
    roots = 1 / np.sqrt(np.clip(np.real(values), LEAST, 1.0))
    return np.real((vectors * roots) @ np.linalg.pinv(vectors))
