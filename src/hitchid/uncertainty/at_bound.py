"""Intervals of parameters that depend on another parameter at a bound of its search."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hitchid.estimation import Objective
from hitchid.uncertainty.parameter_result import ParameterResult
from hitchid.uncertainty.scores import Scores

MAX_STEP = 0.1  # longest step beyond a bound, in the unit cube, to which derivatives there apply; chosen


def over_parameters_at_bound(
    results: Sequence[ParameterResult], objective: Objective, position: Float[np.ndarray, " d"]
) -> list[ParameterResult]:
    """Return the parameters with intervals that do not depend on another one being held at its bound.

    Standard errors are computed with a parameter at a bound held there. The interval of each other one is
    widened, so that it contains

    1. its ends moved by as much as the estimate moves along the profile of the held parameter, over all
       values that the tests do not reject, and
    2. the estimate that least squares would take without the bound, to first order.

    A parameter whose interval is then no longer narrow is determined only for the other one at its bound.

    Args:
        results: all parameters with their intervals.
        objective: identification tests and model specification.
        position: the estimate in the unit cube, shape [D].
    """
    held = [result for result in results if result.bound and result.profile is not None]
    if not held:
        return list(results)
    free = np.array([not (result.bound or result.insensitive) for result in results])
    scores = Scores.of(objective, position)
    steps = [_step_without_bound(other, objective, scores, free) for other in held]
    updated = []
    for result in results:
        if not result.bound and result.is_narrow(result.interval):
            for other, step in zip(held, steps, strict=True):
                result = over_values_of(other, result, float(step[result.number]))
        updated.append(result)
    return updated


def over_values_of(other: ParameterResult, result: ParameterResult, step: float) -> ParameterResult:
    """Return a parameter with its interval over the values of one at its bound, or conditional on it."""
    curve, (lower, upper) = other.profile, result.interval
    if curve is None or lower is None or upper is None:
        return result
    coordinates = curve.positions[:, result.number]
    at_bound = 0 if other.bound == "lower" else -1
    shifts = np.append(coordinates[curve.allowed] - coordinates[at_bound], 0.0)
    unbounded = coordinates[at_bound] + step
    ends = (
        min(result.to_coordinate(lower) + shifts.min(), unbounded),
        max(result.to_coordinate(upper) + shifts.max(), unbounded),
    )
    wider = result.to_interval(*map(float, ends))
    if result.is_narrow(wider):
        return replace(result, interval=wider)
    return replace(result, conditional_on=(*result.conditional_on, other.symbol))


def _step_without_bound(
    other: ParameterResult, objective: Objective, scores: Scores, free: np.ndarray
) -> Float[np.ndarray, " d"]:
    """Return the change of all parameters to first order if the bound of one were removed, shape [D].

    One Gauss-Newton step along its profile, away from the search range: no longer than a tenth of it, and no
    farther than to a value of zero. A bound from the settings is prior knowledge and is not removed.
    """
    step = np.zeros(free.size)
    if other.parameter.name in objective.spec.bounds:
        return step
    selected = free.copy()
    selected[other.number] = True
    columns = np.flatnonzero(selected)
    subset = scores.select_parameters(selected)
    tangent = subset.profile_tangent(int(np.searchsorted(columns, other.number)))
    curvature = float(tangent @ subset.curvature @ tangent)
    if not curvature > 0:
        return step
    change = -float(subset.slopes.sum(axis=0) @ tangent) / curvature
    width = other.upper - other.lower if other.linear else float(np.log(other.upper / other.lower))
    to_zero = (other.lower if other.linear else 1.0) / width if other.lower >= 0 else MAX_STEP
    outward = (
        np.clip(change, -min(MAX_STEP, to_zero), 0.0)
        if other.bound == "lower"
        else np.clip(change, 0.0, MAX_STEP)
    )
    step[columns] = outward * tangent
    return step
