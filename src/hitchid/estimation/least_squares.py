"""Bounded nonlinear least squares in the unit cube, from the normal equations of compiled programs."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid._support.records import short_repr
from hitchid.errors import FitError
from hitchid.estimation.search_problem import NormalEquations, SearchProblem

INITIAL_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-12, 1e12  # λ, relative to the scaled curvature
MIN_GAIN_RATIO = 1e-4  # share of the predicted decrease that a step must reach
# Of the unit cube: longest step; share of the way to a bound that a step may go; what is closer may reach it.
MAX_STEP, BOUND_FRACTION, BOUND_TOLERANCE = 0.1, 0.9, 1e-3
MIN_SCALE = 1e-300  # of a parameter without effect


class StopReason(Enum):
    """Why least squares stopped, with what to try."""

    CONVERGED = "converged: the sum of squares no longer decreases"
    LIMIT = "the maximum number of steps was reached; more may improve the fit"
    NOT_FINITE = (
        "after every step the simulation or its derivatives contained infinite or NaN "
        "values; set narrower bounds"
    )


class Minimum(NamedTuple):
    """Local minimum found by least squares.

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
    """Descend from a position to its local minimum within the unit cube.

    (JᵀJ + λ D) s = −Jᵀr with D the largest diagonal of JᵀJ met so far, projected onto the cube; parameters at
    a bound that the gradient holds there stay. λ follows the gain ratio (Nielsen 1999, IMM-REP-1999-05); a
    step to where anything is not finite is rejected like one that does not descend.
    The limit is one of positions, the tolerance a relative change of cost or position.

    Returns:
        The minimum; None where the equations are not finite at the start.

    Source: Marquardt 1963, J. SIAM 11, 431; Moré 1978, Lecture Notes in Mathematics 630, 105 (scaling).
    """
    position = np.clip(np.asarray(start, float), 0.0, 1.0)
    current = equations(position)
    if not current.finite:
        return None
    damping, growth, steps = INITIAL_DAMPING, 2.0, 1
    scale = np.maximum(np.diag(current.curvature), MIN_SCALE)
    reason = StopReason.LIMIT
    while steps < limit:
        step = _step(current, position, damping * scale)
        predicted_decrease = -float(2 * current.gradient @ step + step @ current.curvature @ step)
        if np.all(np.abs(step) <= tolerance * (tolerance + np.abs(position))):
            reason = StopReason.CONVERGED
            break
        trial = equations(position + step)
        steps += 1
        actual_decrease = current.cost - trial.cost if trial.finite else -np.inf
        if predicted_decrease > 0 and actual_decrease > MIN_GAIN_RATIO * predicted_decrease:
            converged = max(actual_decrease, predicted_decrease) <= tolerance * current.cost
            position, current = position + step, trial
            scale = np.maximum(scale, np.diag(current.curvature))
            damping = max(
                damping * max(1 / 3, 1 - (2 * actual_decrease / predicted_decrease - 1) ** 3), MIN_DAMPING
            )
            growth = 2.0
        else:
            converged = trial.finite and abs(predicted_decrease) <= tolerance * current.cost
            damping, growth = damping * growth, 2 * growth
            if damping > MAX_DAMPING:
                reason = StopReason.CONVERGED if trial.finite else StopReason.NOT_FINITE
                break
        if converged:
            reason = StopReason.CONVERGED
            break
    return Minimum(position, current, steps, reason)


@short_repr
@dataclass(frozen=True)
class LeastSquaresResult:
    """Result of least squares.

    Attributes:
        position: in the unit cube, shape [D].
        fitness: root mean square of the residuals.
        evaluations: simulations of all tests, a Jacobian counting one for each dimension.
        reason: why it stopped.
    """

    position: np.ndarray
    fitness: float
    evaluations: int
    reason: StopReason


def refine(
    problem: SearchProblem, start: np.ndarray, *, limit: int = 200, tolerance: float = 1e-14
) -> LeastSquaresResult:
    """Descend from a position to its local minimum by bounded nonlinear least squares; see `minimise`.

    Args:
        problem: what to minimise.
        start: a position in the unit cube.
        limit: largest number of positions, the start included.
        tolerance: relative change of fitness or position below which to stop.

    Raises:
        FitError: the residuals at the start or their derivative are not finite.
    """
    minimum = minimise(problem.normal_equations, start, limit=limit, tolerance=tolerance)
    if minimum is None:
        raise FitError(
            "at the start values of least squares the simulation contains infinite or NaN "
            "values; set narrower bounds"
        )
    return LeastSquaresResult(
        position=minimum.position,
        fitness=float(np.sqrt(minimum.equations.cost / problem.samples)),
        evaluations=minimum.steps * (1 + problem.dimensions),
        reason=minimum.reason,
    )


def best_refined(
    problem: SearchProblem, starts: Iterable[np.ndarray], *, limit: int, tolerance: float
) -> LeastSquaresResult:
    """Return the best of several least squares; a start that cannot be simulated is left out.

    Raises:
        FitError: none of the starts can be simulated.
    """
    results, failure = [], FitError("least squares: expected at least one start, got none")
    for start in starts:
        try:
            results.append(refine(problem, start, limit=limit, tolerance=tolerance))
        except FitError as error:
            failure = error
    if not results:
        raise failure
    return min(results, key=lambda result: result.fitness)


def _step(current: NormalEquations, position: np.ndarray, damping: np.ndarray) -> Float[np.ndarray, " d"]:
    """Return the damped step, which ends within the cube.

    It goes no farther than a tenth of the cube, and nine tenths of the way to a bound until it is close, for
    a parameter that meets a bound early stays there. The others are solved again without it.
    """
    step = np.zeros_like(position)
    fixed = ((position <= 0) & (current.gradient > 0)) | ((position >= 1) & (current.gradient < 0))
    damped = current.curvature + np.diag(damping)
    lowest = np.where(position <= BOUND_TOLERANCE, -position, -BOUND_FRACTION * position)
    highest = np.where(1 - position <= BOUND_TOLERANCE, 1 - position, BOUND_FRACTION * (1 - position))
    while not fixed.all():
        free = ~fixed
        reduced_gradient = current.gradient[free] + current.curvature[np.ix_(free, fixed)] @ step[fixed]
        step[free] = -np.linalg.lstsq(damped[np.ix_(free, free)], reduced_gradient, rcond=None)[0]
        violating = free & ((step < lowest) | (step > highest))
        if not violating.any():
            break
        fixed |= violating
        step = np.clip(step, lowest, highest)
    return step * min(1.0, MAX_STEP / max(float(np.abs(step).max()), MAX_STEP))
