"""Influence of each test on each estimate: standard errors, correlations and bootstrap."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid._support.short_repr import short_repr
from hitchid.estimation import Objective, refine_subset
from hitchid.uncertainty.dead_zone_error import DeadZoneError, t_quantile, welch_satterthwaite
from hitchid.uncertainty.profile import Profile
from hitchid.uncertainty.scores import MIN_EIGENVALUE, Scores

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
        no_influence = np.zeros((tests, parameters))
        scores = Scores(np.zeros((tests, 0)), np.zeros((tests, 0, 0)))
        free, shifted_estimates = np.zeros(parameters, bool), np.zeros((2, parameters))
        return cls(
            no_influence,
            np.zeros(parameters),
            np.ones(parameters),
            no_influence,
            scores,
            free,
            shifted_estimates,
        )

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Covariance of the estimates, shape [D, D]."""
        return self.by_test.T @ self.by_test + np.outer(self.by_dead_zone, self.by_dead_zone)

    @property
    def errors(self) -> Float[np.ndarray, " d"]:
        """Standard errors of the estimates, shape [D]."""
        return np.sqrt(np.diag(self.covariance))

    def error(self, weights: np.ndarray) -> float:
        """Return the standard error of a linear combination of parameters, weights of shape [D]."""
        return float(np.sqrt(weights @ self.covariance @ weights))

    def half_width(self, weights: np.ndarray, degrees: float) -> float:
        """Return half the width of the 95 % interval of a linear combination of parameters."""
        return t_quantile(degrees) * self.error(weights)

    def combination_degrees(self, combinations: Float[np.ndarray, "d q"]) -> Float[np.ndarray, " q"]:
        """Return the degrees of freedom of combinations' standard errors, without the dead zone's share."""
        return self.scores.degrees_of_freedom(combinations[self.free])


def compute_influence(
    objective: Objective,
    position: np.ndarray,
    free: np.ndarray,
    dead_zone: DeadZoneError,
    *,
    seed: int,
) -> Influence:
    """Return the influence of each test, and of the dead zone, on the estimates.

    Args:
        objective: identification tests and model specification.
        position: the estimates in the unit cube, shape [D].
        free: mask of the parameters that are sensitive and not at a bound, shape [D].
        dead_zone: standard error of the dead zone.
        seed: of the bootstrap.
    """
    scores = _fit_and_pooled_scores(objective, position, free)
    by_test = _influence_by_test(*scores)
    tests = len(by_test)
    rng = np.random.default_rng(seed)
    test_counts = rng.multinomial(tests, np.full(tests, 1 / tests), BOOTSTRAP_DRAWS)
    shifted_estimates = _shifted_estimates(objective, position, free, dead_zone)
    by_dead_zone = 0.5 * (shifted_estimates[0] - shifted_estimates[1])[free]
    variances = np.stack([np.sum(by_test**2, axis=0), by_dead_zone**2])
    test_degrees = scores[0].degrees_of_freedom()
    degrees = welch_satterthwaite(
        variances, np.stack([test_degrees, np.full_like(test_degrees, dead_zone.degrees_of_freedom)])
    )

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
        shifted_objective = coarse_objective.with_data(
            coarse_objective.batch.with_dead_zones(coarse_objective.batch.dead_zone + shift)
        )
        indices = np.flatnonzero(free).tolist()
        estimates[row] = _refit(shifted_objective, indices, position)
        if objective.per_test_gain and free[GAIN_INDEX]:
            estimates[row] = _refit(shifted_objective.pooled(), [GAIN_INDEX], estimates[row])
    return estimates


def _refit(objective: Objective, indices: list[int], position: np.ndarray) -> np.ndarray:
    refitted_position = position.copy()
    refitted_position[indices] = refine_subset(
        objective, indices, [position], REFIT_STEPS, TOLERANCE
    ).position
    return refitted_position


def _fit_and_pooled_scores(objective: Objective, position: np.ndarray, free: np.ndarray) -> list[Scores]:
    """Return the scores of the fit; with a gain per test, also those of the pooled fit of the gain."""
    scores = [Scores.of(objective, position).select_parameters(free)]
    return (
        [*scores, Scores.of(objective.pooled(), position).select_parameters(free)]
        if objective.per_test_gain
        else scores
    )


def _influence_by_test(scores: Scores, gain_scores: Scores | None = None) -> np.ndarray:
    influence = scores.influence()
    if gain_scores is None:
        return influence
    gain_curvature = gain_scores.curvature[0]
    leverage = gain_scores.curvatures[:, 0, 0] / gain_curvature[0]
    slopes = gain_scores.slopes[:, 0] / np.sqrt(np.clip(1 - leverage, MIN_EIGENVALUE, 1.0))
    influence[:, 0] = -(slopes + influence[:, 1:] @ gain_curvature[1:]) / gain_curvature[0]
    return influence


def _newton_steps(scores: Sequence[Scores], weights: np.ndarray) -> np.ndarray:
    """Return the Newton steps of the estimates for other weights of the tests, shape [B, D].

    Args:
        scores: at the estimate.
        weights: how often each test is drawn, shape [B, T].
    """
    slopes = [weights @ test_scores.slopes for test_scores in scores]
    curvatures = [np.einsum("bt,tij->bij", weights, test_scores.curvatures) for test_scores in scores]
    steps = -np.einsum("bij,bj->bi", np.linalg.pinv(curvatures[0], hermitian=True), slopes[0])
    if len(scores) > 1:
        gain_curvature = curvatures[1][:, 0]
        steps[:, 0] = (
            -(slopes[1][:, 0] + np.sum(gain_curvature[:, 1:] * steps[:, 1:], axis=1)) / gain_curvature[:, 0]
        )
    return steps
