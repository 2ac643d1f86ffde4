"""Bounded nonlinear least squares in the unit cube, from the normal equations of compiled programs."""

from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-12, 1e12
ACCEPTED = 1e-4
FARTHEST, NEARER, CLOSE = 0.1, 0.9, 1e-3
FINEST = 1e-300


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

    def over(self, columns: np.ndarray) -> "NormalEquations":
        """Return those of some of the parameters, by their numbers."""
        return NormalEquations(self.cost, self.gradient[columns], self.curvature[np.ix_(columns, columns)])


class StopReason(Enum):
    """Why least squares stopped, with what to try."""

    CONVERGED = "the sum of squares no longer falls"
    LIMIT = "all steps were taken; more of them may still improve the fit"
    NOT_FINITE = "the simulation or its derivative is not finite wherever a step leads; narrow the bounds"


class Minimum(NamedTuple):
    """Where least squares ended.

    Attributes:
        position: in the unit cube, shape [D].
        equations: the normal equations there.
        steps: positions at which they were taken.
        reason: why it stopped.
    """

    position: Float[np.ndarray, " d"]
    equations: NormalEquations
    steps: int
    reason: StopReason


def minimise(
    equations: Callable[[np.ndarray], NormalEquations],
    start: Float[np.ndarray, " d"],
    *,
    limit: int,
    tolerance: float,
) -> Minimum | None:
    """Descend from a position to the bottom of its valley within the unit cube.

    (JᵀJ + λ D) s = −Jᵀr with D the largest diagonal of JᵀJ met so far, projected onto the cube; parameters at
    a bound that the gradient holds there stay. λ follows the gain ratio (Nielsen 1999, IMM-REP-1999-05); a
    step to where anything is not finite is rejected like one that does not descend.

    Args:
        equations: the normal equations at a position.
        start: a position in the unit cube, shape [D].
        limit: largest number of positions.
        tolerance: relative change of cost or position below which to stop.

    Returns:
        The minimum; None where the equations are not finite at the start.

    Source: Marquardt 1963, J. SIAM 11, 431; Moré 1978, Lecture Notes in Mathematics 630, 105 (scaling).
    """
    position = np.clip(np.asarray(start, float), 0.0, 1.0)
    here = equations(position)
    if not here.finite:
        return None
    damping, growth, steps = DAMPING, 2.0, 1
    scale = np.maximum(np.diag(here.curvature), FINEST)
    reason = StopReason.LIMIT
    while steps < limit:
        step = _step(here, position, damping * scale)
        fall = -float(2 * here.gradient @ step + step @ here.curvature @ step)
        if np.all(np.abs(step) <= tolerance * (tolerance + np.abs(position))):
            reason = StopReason.CONVERGED
            break
        there = equations(position + step)
        steps += 1
        gained = here.cost - there.cost if there.finite else -np.inf
        if fall > 0 and gained > ACCEPTED * fall:
            settled = max(gained, fall) <= tolerance * here.cost
            position, here = position + step, there
            scale = np.maximum(scale, np.diag(here.curvature))
            damping = max(damping * max(1 / 3, 1 - (2 * gained / fall - 1) ** 3), LEAST_DAMPING)
            growth = 2.0
        else:
            settled = there.finite and abs(fall) <= tolerance * here.cost
            damping, growth = damping * growth, 2 * growth
            if damping > MOST_DAMPING:
                reason = StopReason.CONVERGED if there.finite else StopReason.NOT_FINITE
                break
        if settled:
            reason = StopReason.CONVERGED
            break
    return Minimum(position, here, steps, reason)


def _step(here: NormalEquations, position: np.ndarray, damping: np.ndarray) -> Float[np.ndarray, " d"]:
    """Return the damped step, which ends within the cube.

    It goes no farther than a tenth of the cube, and nine tenths of the way to a bound until it is close: what
    meets a bound early stays there while the others go the wrong way. The others are solved anew without it.
    """
    step = np.zeros_like(position)
    held = ((position <= 0) & (here.gradient > 0)) | ((position >= 1) & (here.gradient < 0))
    damped = here.curvature + np.diag(damping)
    lowest = np.where(position <= CLOSE, -position, -NEARER * position)
    highest = np.where(1 - position <= CLOSE, 1 - position, NEARER * (1 - position))
    while not held.all():
        free = ~held
        pull = here.gradient[free] + here.curvature[np.ix_(free, held)] @ step[held]
        step[free] = -np.linalg.lstsq(damped[np.ix_(free, free)], pull, rcond=None)[0]
        beyond = free & ((step < lowest) | (step > highest))
        if not beyond.any():
            break
        held |= beyond
        step = np.clip(step, lowest, highest)
    return step * min(1.0, FARTHEST / max(float(np.abs(step).max()), FARTHEST))
