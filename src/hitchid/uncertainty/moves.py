"""By how much each test moves each estimate: standard errors, correlations and redrawn tests follow."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid.estimation import Misfit, polish_some
from hitchid.uncertainty.dead_zone_error import DeadZoneError, degrees_together, student
from hitchid.uncertainty.profile import Profile
from hitchid.uncertainty.scores import LEAST, Scores

DRAWS = 999
# Beside the dead zone parameters are fitted anew over this many samples a test, in this many steps; the
# change is small, so that it is the step, not the sum of squares, that must have settled.
COARSE, REFITTED, TOLERANCE = 2048, 15, 1e-12
# The first parameter of every linear structure.
GAIN = 0


class Moves(NamedTuple):
    """How far estimates would move with other tests, in the coordinates between the bounds.

    Attributes:
        by_test: by how much each test moves each estimate, shape [T, D]; zero for one at a bound.
        by_dead_zone: by how much a standard error of the dead zone does, shape [D].
        beside: what fits best a standard error of the dead zone above and below it, shape [2, D].
        degrees: degrees of freedom of each standard error, shape [D].
        redrawn: estimates from tests drawn anew, less the estimate, shape [B, D]; the dead zone is drawn too.
        scores: slopes and curvatures of the tests, over the parameters that are free.
        free: which of the parameters these are, shape [D].
        profiles: of parameters that are not determined.
    """

    by_test: Float[np.ndarray, "t d"]
    by_dead_zone: Float[np.ndarray, " d"]
    degrees: Float[np.ndarray, " d"]
    redrawn: Float[np.ndarray, "b d"]
    scores: Scores
    free: Bool[np.ndarray, " d"]
    beside: Float[np.ndarray, "2 d"]
    profiles: tuple[Profile, ...] = ()

    @classmethod
    def none(cls, tests: int, parameters: int) -> "Moves":
        """Return what is known where nothing could be computed: that nothing moves anything."""
        nothing = np.zeros((tests, parameters))
        scores = Scores(np.zeros((tests, 0)), np.zeros((tests, 0, 0)))
        free, beside = np.zeros(parameters, bool), np.zeros((2, parameters))
        return cls(nothing, np.zeros(parameters), np.ones(parameters), nothing, scores, free, beside)

    @property
    def covariance(self) -> Float[np.ndarray, "d d"]:
        """Of the estimates, shape [D, D]."""
        return self.by_test.T @ self.by_test + np.outer(self.by_dead_zone, self.by_dead_zone)

    @property
    def errors(self) -> Float[np.ndarray, " d"]:
        """The standard errors, shape [D]."""
        return np.sqrt(np.diag(self.covariance))

    def error(self, along: np.ndarray) -> float:
        """Return the standard error of a combination of parameters, its weights of shape [D]."""
        return float(np.sqrt(along @ self.covariance @ along))

    def reach(self, along: np.ndarray, degrees: float) -> float:
        """Return half the width of the 95 % interval of a combination of parameters."""
        return student(degrees) * self.error(along)

    def degrees_of(self, combinations: Float[np.ndarray, "d q"]) -> Float[np.ndarray, " q"]:
        """Return the degrees of freedom of the standard errors of combinations, the dead zone's aside."""
        return self.scores.degrees(combinations[self.free])


def moves(
    misfit: Misfit,
    position: np.ndarray,
    free: np.ndarray,
    dead_zone: DeadZoneError,
    *,
    seed: int,
) -> Moves:
    """Find how far the estimates would move with other tests.

    Args:
        misfit: the tests.
        position: the estimates, shape [D].
        free: which of them do not lie at a bound, shape [D].
        dead_zone: how well it is known.
        seed: draws tests anew.
    """
    scores = _both(misfit, position, free)
    by_test = _influence(*scores)
    tests = len(by_test)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(tests, np.full(tests, 1 / tests), DRAWS)
    beside = _beside(misfit, position, free, dead_zone)
    by_dead_zone = 0.5 * (beside[0] - beside[1])[free]
    variances = np.stack([np.sum(by_test**2, axis=0), by_dead_zone**2])
    own = scores[0].degrees()
    degrees = degrees_together(variances, np.stack([own, np.full_like(own, dead_zone.degrees)]))

    def spread(rows: np.ndarray) -> np.ndarray:
        whole = np.zeros((*rows.shape[:-1], position.size))
        whole[..., free] = rows
        return whole

    other_ramps = rng.standard_t(dead_zone.degrees, (DRAWS, 1))
    return Moves(
        spread(by_test),
        spread(by_dead_zone),
        np.maximum(spread(degrees), 1.0),
        spread(_solved(scores, drawn) + other_ramps * by_dead_zone),
        scores[0],
        free,
        beside,
    )


def _beside(
    misfit: Misfit, position: np.ndarray, free: np.ndarray, dead_zone: DeadZoneError
) -> Float[np.ndarray, "2 d"]:
    """Return what fits best a standard error of the dead zone above and below it.

    A valve curve makes up for most of it, in steps that are too long for a linearisation.
    """
    found = np.stack([position, position])
    if not dead_zone.size > 0 or not free.any():
        return found
    coarse = misfit.over(misfit.batch.thinned(COARSE))
    for row, shift in enumerate((dead_zone.size, -dead_zone.size)):
        shifted = coarse.over(coarse.batch.behind(coarse.batch.dead_zone + shift))
        numbers = np.flatnonzero(free).tolist()
        found[row] = _refitted(shifted, numbers, position)
        if misfit.apart and free[GAIN]:
            found[row] = _refitted(shifted.pooled(), [GAIN], found[row])
    return found


def _refitted(misfit: Misfit, numbers: list[int], position: np.ndarray) -> np.ndarray:
    moved = position.copy()
    moved[numbers] = polish_some(misfit, numbers, [position], REFITTED, TOLERANCE).position
    return moved


def _both(misfit: Misfit, position: np.ndarray, free: np.ndarray) -> list[Scores]:
    """Return the scores, and where tests had factors of their own those that the gain is found from."""
    found = [Scores.of(misfit, position).over(free)]
    return [*found, Scores.of(misfit.pooled(), position).over(free)] if misfit.apart else found


def _influence(scores: Scores, level: Scores | None = None) -> np.ndarray:
    found = scores.influence()
    if level is None:
        return found
    own = level.curvature[0]
    share = level.curvatures[:, 0, 0] / own[0]
    slopes = level.slopes[:, 0] / np.sqrt(np.clip(1 - share, LEAST, 1.0))
    found[:, 0] = -(slopes + found[:, 1:] @ own[1:]) / own[0]
    return found


def _solved(scores: Sequence[Scores], weights: np.ndarray) -> np.ndarray:
    """Return by how much estimates move where tests have other weights, shape [B, D].

    Args:
        scores: at the estimate.
        weights: of each test, shape [B, T].
    """
    slopes = [weights @ each.slopes for each in scores]
    curvatures = [np.einsum("bt,tij->bij", weights, each.curvatures) for each in scores]
    found = -np.einsum("bij,bj->bi", np.linalg.pinv(curvatures[0], hermitian=True), slopes[0])
    if len(scores) > 1:
        own = curvatures[1][:, 0]
        found[:, 0] = -(slopes[1][:, 0] + np.sum(own[:, 1:] * found[:, 1:], axis=1)) / own[:, 0]
    return found
