"""Scores: gradients and Gauss-Newton matrices of the squared errors, one row per test."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc, stdtrit

from hitchid.estimation import Objective
from hitchid.estimation.objective import TestEquations
from hitchid.model.provenance import DifferenceTest

# Standard error of the dead zone, which is identified before the parameters, and its degrees of freedom.

CONFIDENCE = 0.95  # level of every interval


class DeadZoneError(NamedTuple):
    """Standard error of the dead zone.

    Attributes:
        standard_error: in the command's unit; 0 for a dead zone that was given.
        tests: number of ramps or tests it was identified from.
    """

    standard_error: float = 0.0
    tests: int = 0

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the standard error."""
        return max(self.tests - 1, 1)


NO_ERROR = DeadZoneError()


def with_shifted_dead_zone(objective: Objective, shift: float) -> Objective:
    """Return an objective whose tests have another dead zone, larger by a shift in the command's unit."""
    return objective.with_data(objective.batch.with_dead_zones(objective.batch.dead_zone + shift))


def welch_satterthwaite(variances: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return the degrees of freedom of sums of variances, (Σ v)²/Σ v²/ν (Welch 1947, Biometrika 34, 28)."""
    denominator = np.sum(variances**2 / degrees, axis=0)
    degrees = np.sum(variances, axis=0) ** 2 / np.maximum(denominator, np.finfo(float).tiny)
    return np.asarray(np.maximum(degrees, 1.0))


def combined_variance(
    by_test: Float[np.ndarray, "t q"],
    by_dead_zone: Float[np.ndarray, " q"],
    test_degrees: Float[np.ndarray, " q"],
    dead_zone: DeadZoneError,
) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, " q"]]:
    """Return variances and degrees of freedom of quantities that tests and the dead zone change.

    Args:
        by_test, by_dead_zone: changes due to each test, and per standard error of the dead zone.
        test_degrees: degrees of freedom of the part due to the tests.
        dead_zone: standard error of the dead zone.
    """
    variances = np.stack([np.sum(by_test**2, axis=0), by_dead_zone**2])
    degrees = np.stack([test_degrees, np.full_like(test_degrees, dead_zone.degrees_of_freedom)])
    return variances.sum(axis=0), welch_satterthwaite(variances, degrees)


def t_quantile(degrees: float) -> float:
    """Return the two-sided 95 % quantile of Student's t."""
    return float(stdtrit(degrees, 0.5 + CONFIDENCE / 2))


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
        # Of too few tests no covariance of so many parameters follows: sections of them are the rows.
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
        """Return the scores of some of the parameters."""
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
        roots = []
        for curvature in self.curvatures:
            # (I − P)^(−½): its eigenvalues lie between 0 and 1.
            values, vectors = np.linalg.eig(np.eye(len(inverse)) - curvature @ inverse)
            scale = 1 / np.sqrt(np.clip(np.real(values), MIN_EIGENVALUE, 1.0))
            roots.append(np.real((vectors * scale) @ np.linalg.pinv(vectors)))
        return inverse, np.stack(roots)


# Test whether two independent groups of tests have the same parameters.

MIN_RELATIVE_VARIANCE = 1e-14  # smallest eigenvalue of C over its largest: below it C is singular to rounding
MIN_DENOMINATOR_DEGREES = 1.0  # fewest degrees of freedom of the denominator of F; chosen


def difference_test(
    difference: Float[np.ndarray, " p"], one: Scores, other: Scores, names: Sequence[str]
) -> DifferenceTest | None:
    """Test the difference of the estimates of two groups of tests by Hotelling's statistic.

    W = dᵀ C⁻¹ d with C = C₁ + C₂, the cluster-robust covariances of the two groups (`Scores.influence`):
    tests are independent, the samples of one test need not be. (ν − p + 1)/(ν p) W is compared with F at p
    and ν − p + 1 degrees of freedom. The covariances differ, so that (Krishnamoorthy & Yu 2004, Statist.
    Probab. Lett. 66, 161)

        ν = (p + p²) / Σᵢ (tr((Cᵢ C⁻¹)²) + (tr(Cᵢ C⁻¹))²)/νᵢ

    with νᵢ the mean of the degrees of freedom of group i over the p uncorrelated combinations C^(−½) d.

    Args:
        difference: of the estimates d, in the unit cube.
        one, other: scores of the two groups at their estimates, over the parameters compared.
        names: of these parameters.

    Returns:
        The test; None where the degrees of freedom do not suffice, and where C is singular.
    """
    parameters = difference.size
    covariances = [influence.T @ influence for influence in (one.influence(), other.influence())]
    variances, vectors = np.linalg.eigh(sum(covariances))
    if not variances[0] > MIN_RELATIVE_VARIANCE * variances[-1]:
        return None
    # In these coordinates the differences are uncorrelated, each of variance one.
    whitening = vectors / np.sqrt(variances)
    shares = [whitening.T @ covariance @ whitening for covariance in covariances]
    group_degrees = [float(scores.degrees_of_freedom(whitening).mean()) for scores in (one, other)]
    degrees = (parameters + parameters**2) / sum(
        (float(np.sum(share**2)) + float(np.trace(share)) ** 2) / group
        for share, group in zip(shares, group_degrees, strict=True)
    )
    denominator = degrees - parameters + 1
    if denominator < MIN_DENOMINATOR_DEGREES:
        return None
    statistic = denominator / (degrees * parameters) * float(np.sum((difference @ whitening) ** 2))
    p_value = float(fdtrc(parameters, denominator, statistic))
    return DifferenceTest(statistic, tuple(names), denominator, p_value)
