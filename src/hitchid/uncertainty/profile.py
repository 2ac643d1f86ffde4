"""Profiles: one parameter fixed, all others refitted, until a score test rejects the value."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hitchid.estimation import Objective, refine_subset
from hitchid.uncertainty.scores import (
    NO_ERROR,
    DeadZoneError,
    Scores,
    t_quantile,
    welch_satterthwaite,
    with_shifted_dead_zone,
)

FIRST_STEP = 0.02  # first step from the estimate, in the unit cube, doubled every time; all values chosen
BISECTION_STEPS = 4  # of an end of the interval
REFIT_STEPS, TOLERANCE = 5, 1e-4  # of the other parameters: steps, relative change of the sum of squares
MIN_TESTS = 4  # fewest tests for the t-test on the RMSE by test
STEP, MIN_PACE, MAX_PACE = 1e-4, 0.1, 10.0  # rates beyond an end: difference step, limits
TINY = 1e-300  # least curvature, for a division
MIN_RELATIVE_DECREASE = 1e-9  # of the sum of squares, or of the RMSE; smaller changes are rounding errors


class Profile(NamedTuple):
    """Profile of one parameter; computed where its Gauss-Newton interval is wide.

    Attributes:
        number: index of the parameter.
        lower, upper: ends of the 95 % interval in the unit cube; None, open, where the tests do not reject a
            search bound that is not a physical bound.
        positions: points of the profile, ascending, the other parameters refitted, shape [K, D].
        fitness: RMSE at each point, shape [K].
        allowed: whether the point is not rejected at 95 %; ends of the interval are allowed, shape [K].
        tangents: derivatives of all parameters along the profile, shape [K, D].
        search_range: log(upper/lower) of the bounds on a logarithmic scale, 1 on a linear one.
    """

    number: int
    lower: float | None
    upper: float | None
    positions: np.ndarray
    fitness: np.ndarray
    allowed: np.ndarray
    tangents: np.ndarray
    search_range: float


def profile(
    objective: Objective, position: np.ndarray, number: int, dead_zone: DeadZoneError = NO_ERROR
) -> Profile:
    """Return the profile of one parameter: the values that the tests do not reject at 95 %.

    A value is rejected if, with all others refitted, the mean over tests of the slope of the squared errors
    along the parameter differs from zero by Student's t, or the mean increase of the tests' RMSE over that of
    the estimate does (the slope vanishes far from the estimate). Errors within a test may be correlated in
    any way, and the parameter may go to infinity. This is the score test of Rao (1948, Math. Proc. Camb.
    Phil. Soc. 44, 50) with tests as the sampling units.
    """
    others = [index for index in range(position.size) if index != number]
    points: list[_ProfilePoint] = []
    # The error of the dead zone affects all tests in the same way: their scatter does not show it.
    shifted = (
        [with_shifted_dead_zone(objective, dead_zone.standard_error)] if dead_zone.standard_error else []
    )
    objectives = [objective, *shifted]
    best_errors = [term.rmse_by_test(position) for term in objectives]

    def fit_at(coordinate: float, start: np.ndarray) -> _ProfilePoint:
        fitted_position = start.copy()
        fitted_position[number] = coordinate
        if others and coordinate != position[number]:
            fit = refine_subset(objective, others, [fitted_position], REFIT_STEPS, TOLERANCE)
            fitted_position[others] = fit.position
        points.append(_ProfilePoint.evaluate(objectives, fitted_position, number, dead_zone, best_errors))
        return points[-1]

    # The estimate itself counts as allowed, whatever slope the end of the search has left.
    best = replace(fit_at(float(position[number]), position), excess=0.0)
    lower, upper = (_interval_end(fit_at, position, number, bound) for bound in (0.0, 1.0))
    # A bound given in the settings is prior knowledge, and closes the interval.
    if objective.spec.parameters[number].name in objective.spec.bounds:
        lower, upper = lower or 0.0, 1.0 if upper is None else upper
    ordered = sorted([best, *points[1:]], key=lambda point: float(point.position[number]))
    return Profile(
        number,
        lower,
        upper,
        positions=np.stack([point.position for point in ordered]),
        fitness=np.array([point.fitness for point in ordered]),
        allowed=np.array([p.excess <= 1 or p.position[number] in (lower, upper) for p in ordered]),
        tangents=np.stack([point.tangent for point in ordered]),
        search_range=_search_range(objective, number),
    )


def _interval_end(
    fit_at: "Callable[[float, np.ndarray], _ProfilePoint]", position: np.ndarray, number: int, bound: float
) -> float | None:
    """Return the end of the interval toward a bound; None where the bound is not rejected."""
    inside, start, width = float(position[number]), position, FIRST_STEP
    sign, outside = np.sign(bound - inside), None
    # Ever longer steps until one is rejected, then halving; each starts where the one before ended.
    while outside is None and inside != bound:
        coordinate = float(np.clip(inside + sign * width, 0.0, 1.0))
        point = fit_at(coordinate, start)
        start, width = point.position, 2 * width
        inside, outside = (inside, coordinate) if point.excess > 1 else (coordinate, None)
    if outside is None:
        return None
    for _ in range(BISECTION_STEPS):
        middle = 0.5 * (inside + outside)
        point = fit_at(middle, start)
        start = point.position
        inside, outside = (inside, middle) if point.excess > 1 else (middle, outside)
    return outside


def _search_range(objective: Objective, number: int) -> float:
    lower, upper = float(objective.bounds.lower[number]), float(objective.bounds.upper[number])
    return 1.0 if bool(objective.bounds.linear[number]) else float(np.log(upper / lower))


@dataclass(frozen=True)
class _ProfilePoint:
    """One point of a profile; `excess` is the test statistic over its limit, above 1 rejected."""

    position: np.ndarray
    fitness: float
    excess: float
    tangent: np.ndarray

    @classmethod
    def evaluate(
        cls,
        objectives: Sequence[Objective],
        position: np.ndarray,
        number: int,
        dead_zone: DeadZoneError,
        best_errors: Sequence[np.ndarray],
    ) -> "_ProfilePoint":
        """Test a position; `objectives`: with the dead zone, and with it one standard error larger."""
        equations = [objective.equations_by_test(position) for objective in objectives]
        scores = [
            Scores.of(objective, position, of_tests)
            for objective, of_tests in zip(objectives, equations, strict=True)
        ]
        tangent = scores[0].profile_tangent(number)
        slopes, shifted_slopes = scores[0].slopes @ tangent, scores[-1].slopes @ tangent
        excess, cost, slope = 0.0, float(equations[0].costs.sum()), float(slopes.sum())
        expected_decrease = slope**2 / max(float(tangent @ scores[0].curvature @ tangent), TINY)
        # A slope that changes nothing from bound to bound is rounding, too, however flat its surroundings.
        if min(expected_decrease, abs(slope)) > MIN_RELATIVE_DECREASE * cost:
            shift = float(shifted_slopes.sum() - slopes.sum()) / slopes.size
            degrees = slopes.size - position.size
            excess = _relative_excess(abs(float(slopes.mean())), slopes, shift, degrees, dead_zone)
        errors = [
            objective.rmse_of(of_tests.costs)
            for objective, of_tests in zip(objectives, equations, strict=True)
        ]
        increases = [of_tests - best for of_tests, best in zip(errors, best_errors, strict=True)]
        # Far from the optimum the slope may vanish; there a value is excluded by the growth of the errors.
        mean = float(increases[0].mean())
        if increases[0].size >= MIN_TESTS and mean > MIN_RELATIVE_DECREASE * float(best_errors[0].mean()):
            shift = float(increases[-1].mean()) - mean
            growth = _relative_excess(mean, increases[0], shift, increases[0].size - 1, dead_zone)
            excess = max(excess, growth)
        fitness = float(np.sqrt(np.mean(errors[0][errors[0] > 0] ** 2)))
        return cls(position, fitness, excess, tangent)


def _relative_excess(
    mean: float, by_test: np.ndarray, shift: float, degrees: int, dead_zone: DeadZoneError
) -> float:
    """Return a mean over tests divided by the limit of its two-sided t-test at 95 %."""
    variances = np.array([by_test.var(ddof=1) / by_test.size, shift**2])
    combined_degrees = welch_satterthwaite(
        variances, np.array([max(degrees, 1), dead_zone.degrees_of_freedom])
    )
    limit = t_quantile(float(combined_degrees)) * float(np.sqrt(variances.sum()))
    return mean / limit if limit > 0 else 0.0


def open_ends(profiles: Iterable[Profile], quantity: Callable[[np.ndarray], float]) -> tuple[bool, bool]:
    """Return whether a quantity falls, and whether it rises, beyond an open end of any profile.

    At an open end the parameter is unbounded, and so is a quantity that changes at more than a tenth of its
    rate. Tangents are clipped at ten times its rate: faster parameters hardly affect the model.
    """
    open_below = open_above = False
    for curve in profiles:
        for number, step in [(0, -STEP)] * (curve.lower is None) + [(-1, STEP)] * (curve.upper is None):
            end = curve.positions[number]
            outward = step * np.clip(curve.tangents[number], -MAX_PACE, MAX_PACE)
            pace = (quantity(end + outward) - quantity(end - outward)) / (2 * STEP * curve.search_range)
            open_below, open_above = open_below or pace < -MIN_PACE, open_above or pace > MIN_PACE
    return open_below, open_above
