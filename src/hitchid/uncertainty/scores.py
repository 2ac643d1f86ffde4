"""Scores: gradients and Gauss-Newton matrices of the squared errors, one row per test."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid.estimation import Objective
from hitchid.estimation.objective import TestEquations

MIN_SURPLUS_TESTS = 4  # tests beyond the number of parameters; with fewer, tests are cut in segments; chosen
MIN_EIGENVALUE = 0.05  # smallest eigenvalue of I − leverage, which limits the correction; chosen


class Scores(NamedTuple):
    """Gradients and Gauss-Newton matrices of half the squared errors at one position, one row per test.

    With fewer than four tests more than parameters, a row is one of several segments of a test.

    Attributes:
        slopes: gₜ = Jₜᵀ rₜ, shape [T, D].
        curvatures: Jₜᵀ Jₜ, shape [T, D, D].
    """

    slopes: Float[np.ndarray, "t d"]
    curvatures: Float[np.ndarray, "t d d"]

    @classmethod
    def of(
        cls, objective: Objective, position: np.ndarray, equations: TestEquations | None = None
    ) -> "Scores":
        """Return the scores of an objective at a position in the unit cube.

        Args:
            objective: tests and form.
            position: shape [D].
            equations: those of the tests there, where they are known.
        """
        tests = int(np.count_nonzero(np.asarray(objective.batch.loss_mask).any(axis=1)))
        if tests >= position.size + MIN_SURPLUS_TESTS:
            return cls.by_test(objective, position, equations)
        stretches_per_test = -(-(position.size + MIN_SURPLUS_TESTS) // tests)
        by_segment = objective.equations_by_segment(position, stretches_per_test)
        return cls(by_segment.gradients, by_segment.curvatures)

    @classmethod
    def by_test(
        cls, objective: Objective, position: np.ndarray, equations: TestEquations | None = None
    ) -> "Scores":
        """Return the scores with one row per test, however few tests have samples that count; see `of`."""
        has_data = np.asarray(objective.batch.loss_mask).any(axis=1)
        equations = (equations or objective.equations_by_test(position)).take(np.flatnonzero(has_data))
        return cls(equations.gradients, equations.curvatures)

    def select_parameters(self, free: np.ndarray) -> "Scores":
        """Return the scores of some of the parameters.

        Args:
            free: mask of the parameters, shape [D].
        """
        return Scores(self.slopes[:, free], self.curvatures[:, free][:, :, free])

    @property
    def curvature(self) -> Float[np.ndarray, "d d"]:
        """Gauss-Newton matrix of all tests together."""
        return self.curvatures.sum(axis=0)

    def profile_tangent(self, number: int) -> Float[np.ndarray, " d"]:
        """Return the derivatives along one parameter's profile: 1, others −Hₒₒ⁻¹ Hₒᵢ, shape [D]."""
        others = np.arange(self.slopes.shape[1]) != number
        curvature, tangent = self.curvature, np.ones(self.slopes.shape[1])
        tangent[others] = (
            -np.linalg.pinv(curvature[np.ix_(others, others)], hermitian=True) @ curvature[others, number]
        )
        return tangent

    def influence(self) -> Float[np.ndarray, "t d"]:
        """Return the influence of each test on the estimate, shape [T, D]; squares sum to the variance.

        δₜ = −H⁻¹ Fₜ gₜ with Fₜ = (I − Hₜ H⁻¹)^(−½), which corrects for the leverage of the test (Bell &
        McCaffrey 2002, Survey Methodology 28, 169, CR2). Residuals of one test may be correlated in any way;
        tests are independent of each other.
        """
        inverse, corrections = self._leverage_corrections()
        return -np.einsum("tij,tj->ti", corrections, self.slopes) @ inverse

    def degrees_of_freedom(
        self, combinations: Float[np.ndarray, "d q"] | None = None
    ) -> Float[np.ndarray, " q"]:
        """Return the degrees of freedom of standard errors, shape [Q], at least one.

        (tr Ω)²/‖Ω‖² with Ωₜₛ = |pₜ|² [t = s] − qₜᵀ H⁻¹ qₛ, qₜ = Fₜ Hₜ H⁻¹ c, |pₜ|² = cᵀ H⁻¹ Fₜ qₜ, c the
        combination (Bell & McCaffrey 2002, with white errors).

        Args:
            combinations: weights c of the parameters, shape [D, Q]; None for each parameter alone.
        """
        inverse, corrections = self._leverage_corrections()
        projections = inverse if combinations is None else inverse @ combinations
        corrected = np.einsum("tij,tjk,kd->tid", corrections, self.curvatures, projections)
        sizes = np.einsum("id,tij,tjd->td", projections, corrections, corrected)
        cross_terms = np.einsum("tid,ij,sjd->dts", corrected, inverse, corrected)
        diagonal_terms = np.einsum("td,ts->dts", np.maximum(sizes, 0.0), np.eye(len(sizes)))
        omega = diagonal_terms - cross_terms
        trace = np.einsum("dtt->d", omega)
        return np.maximum(trace**2 / np.maximum(np.sum(omega**2, axis=(1, 2)), 1e-300), 1.0)

    def _leverage_corrections(self) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, "t d d"]]:
        """Return H⁻¹ and each test's Fₜ."""
        inverse = np.linalg.pinv(self.curvature, hermitian=True)
        identity = np.eye(len(inverse))
        return inverse, np.stack(
            [_inverse_square_root(identity - curvature @ inverse) for curvature in self.curvatures]
        )


def _inverse_square_root(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse square root of I − P, whose eigenvalues lie between 0 and 1."""
    values, vectors = np.linalg.eig(matrix)
    roots = 1 / np.sqrt(np.clip(np.real(values), MIN_EIGENVALUE, 1.0))
    return np.real((vectors * roots) @ np.linalg.pinv(vectors))
