"""Influence of each test on each estimate: standard errors, correlations and bootstrap."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import toeplitz

from hitchid._support.records import short_repr
from hitchid.estimation import Objective, refine_subset
from hitchid.estimation.objective import GAIN_RIDGE
from hitchid.model.estimates import Information
from hitchid.uncertainty.profile import Profile
from hitchid.uncertainty.scores import (
    MIN_EIGENVALUE,
    DeadZoneError,
    Scores,
    combined_variance,
    t_quantile,
    with_shifted_dead_zone,
)

BOOTSTRAP_DRAWS = 999  # resamples of the tests; chosen
# Refit with a shifted dead zone: steps, relative tolerance of the sum of squares (tight: the shift of the
# estimates is small). Chosen.
REFIT_STEPS, TOLERANCE = 15, 1e-12
GAIN_INDEX = 0  # the gain is the first parameter of every linear structure


@short_repr
class Influence(NamedTuple):
    """Influence of the tests on the estimates, in the coordinates of the unit cube.

    Attributes:
        by_test: change of each estimate due to each test, shape [T, D]; zero for a parameter at a bound.
        by_dead_zone: change of each estimate per standard error of the dead zone, shape [D].
        degrees_of_freedom: of each standard error, shape [D].
        bootstrap: estimates from resampled tests and dead zones minus the estimate, shape [B, D].
        scores: gradients and Gauss-Newton matrices of the tests, over the free parameters.
        free: mask of the free parameters, shape [D].
        shifted_estimates: estimates with the dead zone a standard error larger and smaller, shape [2, D].
        profiles: of the parameters whose Gauss-Newton interval is wide.
    """

    by_test: Float[np.ndarray, "t d"]
    by_dead_zone: Float[np.ndarray, " d"]
    degrees_of_freedom: Float[np.ndarray, " d"]
    bootstrap: Float[np.ndarray, "b d"]
    scores: Scores
    free: Bool[np.ndarray, " d"]
    shifted_estimates: Float[np.ndarray, "2 d"]
    profiles: tuple[Profile, ...] = ()

    @classmethod
    def zeros(cls, tests: int, parameters: int) -> "Influence":
        """Return zero influence, for estimates without standard errors."""
        none, scores = np.zeros((tests, parameters)), Scores(np.zeros((tests, 0)), np.zeros((tests, 0, 0)))
        zeros, free, shifted = np.zeros(parameters), np.zeros(parameters, bool), np.zeros((2, parameters))
        return cls(none, zeros, np.ones(parameters), none, scores, free, shifted)

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance of the estimates, shape [D, D]."""
        return self.by_test.T @ self.by_test + np.outer(self.by_dead_zone, self.by_dead_zone)

    @property
    def correlation(self) -> Float[np.ndarray, "d d"]:
        """Correlation of the estimates, shape [D, D]; zero for those without a standard error."""
        scale = np.where(self.errors > 0, self.errors, 1.0)
        return self.covariance / np.outer(scale, scale)

    @property
    def errors(self) -> Float[np.ndarray, " d"]:
        """Standard errors of the estimates, shape [D]."""
        return np.sqrt(np.diag(self.covariance))

    def half_width(self, weights: np.ndarray, degrees: float) -> float:
        """Return half the width of the 95 % interval of a linear combination of parameters."""
        return t_quantile(degrees) * float(np.sqrt(weights @ self.covariance @ weights))


def compute_influence(
    objective: Objective, position: np.ndarray, free: np.ndarray, dead_zone: DeadZoneError, *, seed: int
) -> Influence:
    """Return the influence of each test, and of the dead zone, on the estimates.

    Positions are in the unit cube, shape [D]; free are parameters that are sensitive and not at a bound.
    """
    scores = [Scores.of(objective, position).select_parameters(free)]
    by_test = scores[0].influence()
    if objective.per_test_gain:
        # The gain is that of all tests pooled: its influence follows from that of the others.
        scores.append(Scores.of(objective.pooled(), position).select_parameters(free))
        gain_curvature = scores[1].curvature[0]
        # The correction for leverage of `Scores.influence`, of a single parameter.
        leverage = scores[1].curvatures[:, 0, 0] / gain_curvature[0]
        slopes = scores[1].slopes[:, 0] / np.sqrt(np.clip(1 - leverage, MIN_EIGENVALUE, 1.0))
        by_test[:, 0] = -(slopes + by_test[:, 1:] @ gain_curvature[1:]) / gain_curvature[0]
    tests = len(by_test)
    rng = np.random.default_rng(seed)
    # Whole tests are drawn: the samples of one are not independent.
    test_counts = rng.multinomial(tests, np.full(tests, 1 / tests), BOOTSTRAP_DRAWS)
    shifted_estimates = _shifted_estimates(objective, position, free, dead_zone)
    by_dead_zone = 0.5 * (shifted_estimates[0] - shifted_estimates[1])[free]
    test_degrees = scores[0].degrees_of_freedom()
    _, degrees = combined_variance(by_test, by_dead_zone, test_degrees, dead_zone)

    def expand(rows: np.ndarray) -> np.ndarray:
        expanded = np.zeros((*rows.shape[:-1], position.size))
        expanded[..., free] = rows
        return expanded

    dead_zone_draws = rng.standard_t(dead_zone.degrees_of_freedom, (BOOTSTRAP_DRAWS, 1))
    return Influence(
        expand(by_test),
        expand(by_dead_zone),
        np.maximum(expand(degrees), 1.0),
        expand(_newton_steps(scores, test_counts) + dead_zone_draws * by_dead_zone),
        scores[0],
        free,
        shifted_estimates,
    )


def _shifted_estimates(
    objective: Objective, position: np.ndarray, free: np.ndarray, dead_zone: DeadZoneError
) -> Float[np.ndarray, "2 d"]:
    """Return the estimates with the dead zone a standard error larger and smaller.

    They are refitted: a valve curve compensates most of the shift, too far for a linearisation.
    """
    estimates = np.stack([position, position])
    if not dead_zone.standard_error > 0 or not free.any():
        return estimates
    coarse_objective = objective.with_data(objective.batch.coarse())
    for row, shift in enumerate((dead_zone.standard_error, -dead_zone.standard_error)):
        shifted_objective = with_shifted_dead_zone(coarse_objective, shift)
        indices = np.flatnonzero(free).tolist()
        estimates[row] = _refit(shifted_objective, indices, position)
        # The others were fitted with a gain for each test; the one of all tests follows, as in the estimate.
        if objective.per_test_gain and free[GAIN_INDEX]:
            estimates[row] = _refit(shifted_objective.pooled(), [GAIN_INDEX], estimates[row])
    return estimates


def _refit(objective: Objective, indices: list[int], position: np.ndarray) -> np.ndarray:
    refitted_position = position.copy()
    refitted_position[indices] = refine_subset(
        objective, indices, [position], REFIT_STEPS, TOLERANCE
    ).position
    return refitted_position


def _newton_steps(scores: Sequence[Scores], weights: np.ndarray) -> np.ndarray:
    """Return the Newton steps of the estimates for other weights of the tests, shape [B, D]."""
    slopes = [weights @ test_scores.slopes for test_scores in scores]
    curvatures = [np.einsum("bt,tij->bij", weights, test_scores.curvatures) for test_scores in scores]
    steps = -np.einsum("bij,bj->bi", np.linalg.pinv(curvatures[0], hermitian=True), slopes[0])
    if len(scores) > 1:
        gain_curvature = curvatures[1][:, 0]
        steps[:, 0] = (
            -(slopes[1][:, 0] + np.sum(gain_curvature[:, 1:] * steps[:, 1:], axis=1)) / gain_curvature[:, 0]
        )
    return steps


# Fisher information of the tests, with correlated errors, and expected errors after one more test.

LAGS = 100  # blocks of the longest test, lags of the autocovariance; chosen


def information_of(objective: Objective, position: np.ndarray, influence: Influence) -> Information:
    """Return the Fisher information of the tests at the best position."""
    errors, test = objective.errors(position)
    # No test changes a parameter at a bound or without influence: it has no information either.
    free = np.flatnonzero(np.any(influence.by_test != 0, axis=0))
    curvature = objective.equations_by_test(position).curvatures.sum(axis=0)[np.ix_(free, free)]
    covariance = (influence.by_test.T @ influence.by_test)[np.ix_(free, free)]
    counts = np.bincount(test)
    # A covariance for each lag of a long test at a high rate would be as long as the test.
    block_size = max(1, int(counts.max()) // LAGS)
    from_dead_zone = np.outer(influence.by_dead_zone[free], influence.by_dead_zone[free])
    return Information(
        names=tuple(objective.spec.parameters[number].name for number in free),
        slopes=tuple(map(float, objective.slopes(position)[free])),
        curvature=_rows(curvature),
        score_covariance=_rows(curvature @ covariance @ curvature),
        dead_zone_covariance=_rows(from_dead_zone),
        autocovariance=_autocovariance(errors, test, block_size),
        block_size=block_size,
        per_test_gain=objective.per_test_gain,
        tests=int(np.count_nonzero(counts)),
        samples=float(counts[counts > 0].mean()),
    )


def standard_errors(information: Information) -> Float[np.ndarray, " d"]:
    """Return the standard errors from the identification tests, in the unit cube."""
    return _standard_errors(
        information, np.array(information.curvature), np.array(information.score_covariance)
    )


def standard_errors_with_repeat(information: Information) -> Float[np.ndarray, " d"]:
    """Return the standard errors expected after one more test like the identification tests."""
    factor = 1 + 1 / information.tests
    return _standard_errors(
        information, factor * np.array(information.curvature), factor * np.array(information.score_covariance)
    )


def profile_out_gain(
    information: Information, travel: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "n d"]:
    """Return the derivatives of a test without the component that the test's own gain absorbs.

    J − ŷ (ŷᵀJ)/((1 + ρ) ŷᵀŷ), to first order for a well fitted test; see `Objective.residuals`.
    """
    if not information.per_test_gain:
        return jacobian
    return jacobian - np.outer(travel, travel @ jacobian / ((1 + GAIN_RIDGE) * (travel @ travel)))


def standard_errors_with(
    information: Information, jacobian: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, " d"]:
    """Return the standard errors expected after one more test, in the unit cube.

    V' = H'⁻¹ (Σ gₜ gₜᵀ + Jᵀ C J) H'⁻¹, H' = H + Jᵀ J, with C the errors' covariance as in those tests.
    All tests have the same weight in the fit; a longer one has the smaller variance of its mean.
    """
    samples = jacobian.shape[0]
    blocks = -(-samples // information.block_size)
    padded = np.pad(jacobian, ((0, blocks * information.block_size - samples), (0, 0)))
    means = padded.reshape(blocks, information.block_size, -1).sum(axis=1)
    # Errors farther apart than any in the tests so far count as independent.
    covariance = toeplitz(np.resize(np.append(information.autocovariance, np.zeros(blocks)), blocks))
    share = information.samples / samples
    return _standard_errors(
        information,
        np.array(information.curvature) + share * jacobian.T @ jacobian,
        np.array(information.score_covariance) + share**2 * means.T @ covariance @ means,
    )


def _standard_errors(
    information: Information, curvature: np.ndarray, score_covariance: np.ndarray
) -> np.ndarray:
    inverse = np.linalg.pinv(curvature, hermitian=True)
    return np.sqrt(np.diag(inverse @ score_covariance @ inverse + np.array(information.dead_zone_covariance)))


def _autocovariance(errors: np.ndarray, test: np.ndarray, block_size: int) -> tuple[float, ...]:
    """Return the autocovariance of the block means of the errors; biased, hence positive semidefinite."""
    rows = np.split(errors, np.flatnonzero(np.diff(test)) + 1)
    trimmed = [row[: len(row) // block_size * block_size] for row in rows if len(row) >= block_size]
    blocks = [row.reshape(-1, block_size).mean(axis=1) for row in trimmed]
    longest = max(len(row) for row in blocks)
    sums = np.zeros(longest)
    for row in blocks:
        sums[: len(row)] += np.correlate(row, row, "full")[len(row) - 1 :]
    return tuple(map(float, sums / sum(len(row) for row in blocks)))


def _rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)
