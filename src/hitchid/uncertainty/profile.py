"""Profiles: one parameter held at a value, all others fitted, until the tests contradict it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hitchid.estimation import Objective, refine_subset
from hitchid.uncertainty.dead_zone_error import NO_ERROR, DeadZoneError, t_quantile, welch_satterthwaite
from hitchid.uncertainty.scores import Scores

FIRST_STEP = 0.02
BISECTION_STEPS = 4
REFIT_STEPS, TOLERANCE = 5, 1e-4
MIN_TESTS = 4
STEP, MIN_PACE, MAX_PACE = 1e-4, 0.1, 10.0
# A share of the squared misses that no number of samples makes significant: slopes below are rounding.
MIN_RELATIVE_DECREASE = 1e-9


class Profile(NamedTuple):
    """What the tests say of one parameter, wherever the interval of Gauss and Newton is wide.

    Attributes:
        number: which parameter was held.
        lower, upper: ends of the 95 % interval, positions between the bounds; None where the tests allow a
            bound that is none but the search's.
        positions: where it was held, ascending, with all others fitted, shape [K, D].
        fitness: root mean square of the misses there, shape [K].
        allowed: whether the tests allow it, ends of the interval included, shape [K].
        tangents: how the others follow it, shape [K, D].
        search_range: between the bounds, as a difference of logarithms where the search runs in these, else
            1.
    """

    number: int
    lower: float | None
    upper: float | None
    positions: np.ndarray
    fitness: np.ndarray
    allowed: np.ndarray
    tangents: np.ndarray
    search_range: float

    def open_ends(self, quantity: Callable[[np.ndarray], float]) -> tuple[bool, bool]:
        """Tell whether something falls, and whether it rises, where the tests leave this parameter free.

        At an end that is a bound of the search alone the parameter might as well go farther; what goes with
        it by more than a tenth of its own pace is no better known than it is. What would follow at more than
        ten times its pace hardly moves the model, and counts with that.

        Args:
            quantity: from a position, shape [D], to a number, or to its logarithm where that is positive.
        """
        ends = [(0, -STEP)] * (self.lower is None) + [(-1, STEP)] * (self.upper is None)
        open_below = open_above = False
        for number, step in ends:
            end = self.positions[number]
            outward = step * np.clip(self.tangents[number], -MAX_PACE, MAX_PACE)
            pace = (quantity(end + outward) - quantity(end - outward)) / (2 * STEP * self.search_range)
            open_below, open_above = open_below or pace < -MIN_PACE, open_above or pace > MIN_PACE
        return open_below, open_above


def profile(
    objective: Objective, position: np.ndarray, number: int, dead_zone: DeadZoneError = NO_ERROR
) -> Profile:
    """Find what values of one parameter the tests do not contradict.

    A value is contradicted where, all others fitted, the tests agree that another would be better: where the
    mean over tests of the slope along the parameter lies farther from zero than Student's t has it at 95 %,
    or, for the slope levels off far away, where the tests are fitted worse than at the best position by a
    mean that far from zero. That holds however the errors within a test are correlated, and where the
    parameter goes to infinity. It is the score test of Rao (1948, Math. Proc. Camb. Phil. Soc. 44, 50) with
    tests as what is drawn.

    Args:
        objective: the tests.
        position: the best position, shape [D].
        number: which parameter.
        dead_zone: how well it is known; its error moves all tests together.
    """
    others = [index for index in range(position.size) if index != number]
    points: list[_ProfilePoint] = []
    objectives = (
        [objective]
        if dead_zone.standard_error == 0
        else [objective, dead_zone.shifted_by_one_sigma(objective)]
    )
    best_errors = [term.rmse_by_test(position) for term in objectives]

    def fit_at(coordinate: float, start: np.ndarray) -> _ProfilePoint:
        fitted_position = start.copy()
        fitted_position[number] = coordinate
        if others and coordinate != position[number]:
            fitted_position[others] = refine_subset(
                objective, others, [fitted_position], REFIT_STEPS, TOLERANCE
            ).position
        points.append(_ProfilePoint.evaluate(objectives, fitted_position, number, dead_zone, best_errors))
        return points[-1]

    def bisect(inside: float, outside: float, start: np.ndarray) -> float:
        for _ in range(BISECTION_STEPS):
            middle = 0.5 * (inside + outside)
            point = fit_at(middle, start)
            inside, outside, start = (
                (inside, middle, point.position) if point.excess > 1 else (middle, outside, point.position)
            )
        return outside

    def interval_end(bound: float) -> float | None:
        """Return the last place toward a bound that is not contradicted; None where the bound is not."""
        inside, start, width = float(position[number]), position, FIRST_STEP
        sign = np.sign(bound - inside)
        while inside != bound:
            coordinate = float(np.clip(inside + sign * width, 0.0, 1.0))
            point = fit_at(coordinate, start)
            if point.excess > 1:
                return bisect(inside, coordinate, point.position)
            inside, start, width = coordinate, point.position, 2 * width
        return None

    best = replace(fit_at(float(position[number]), position), excess=0.0)
    lower, upper = interval_end(0.0), interval_end(1.0)
    if objective.spec.parameters[number].name in objective.spec.bounds:
        lower, upper = lower or 0.0, 1.0 if upper is None else upper
    bounds = float(objective.bounds.lower[number]), float(objective.bounds.upper[number])
    ordered = sorted([best, *points[1:]], key=lambda point: float(point.position[number]))
    return Profile(
        number=number,
        lower=lower,
        upper=upper,
        positions=np.stack([point.position for point in ordered]),
        fitness=np.array([point.fitness for point in ordered]),
        allowed=np.array(
            [point.excess <= 1 or point.position[number] in (lower, upper) for point in ordered]
        ),
        tangents=np.stack([point.tangent for point in ordered]),
        search_range=1.0 if bool(objective.bounds.linear[number]) else float(np.log(bounds[1] / bounds[0])),
    )


@dataclass(frozen=True)
class _ProfilePoint:
    """One parameter held at a value: where the others end, by how much tests contradict it, 1 the limit."""

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
        """Hold a parameter at a position; `objectives` is the misfit, and that beside the dead zone."""
        scores, *shifted_scores = [Scores.of(objective, position) for objective in objectives]
        tangent = scores.profile_tangent(number)
        slopes = scores.slopes @ tangent
        shift = sum((float((other.slopes @ tangent).sum() - slopes.sum()) for other in shifted_scores), 0.0)
        degrees = slopes.size - position.size
        errors, *shifted_errors = [objective.rmse_by_test(position) for objective in objectives]
        excess = 0.0
        if slopes.sum() ** 2 > MIN_RELATIVE_DECREASE * (tangent @ scores.curvature @ tangent) * objectives[
            0
        ].cost(position):
            excess = _relative_excess(
                abs(float(slopes.mean())), slopes, shift / slopes.size, degrees, dead_zone
            )
        increase, *shifted_increases = [
            fit_errors - best for fit_errors, best in zip((errors, *shifted_errors), best_errors, strict=True)
        ]
        if increase.size >= MIN_TESTS:
            mean = float(increase.mean())
            shift = sum((float(other.mean()) - mean for other in shifted_increases), 0.0)
            excess = max(excess, _relative_excess(mean, increase, shift, increase.size - 1, dead_zone))
        fitness = float(np.sqrt(np.mean(errors[errors > 0] ** 2)))
        return cls(position, fitness, excess, tangent)


def _relative_excess(
    mean: float, by_test: np.ndarray, shift: float, degrees: int, dead_zone: DeadZoneError
) -> float:
    """Return how far a mean over tests lies from zero, 1 where Student's t has its limit at 95 %.

    Args:
        mean: of what the tests say.
        by_test: what each of them says.
        shift: what a standard error of the dead zone adds to the mean.
        degrees: of freedom of the tests' spread.
        dead_zone: how well it is known.
    """
    variances = np.array([by_test.var(ddof=1) / by_test.size, shift**2])
    combined_degrees = welch_satterthwaite(
        variances, np.array([max(degrees, 1), dead_zone.degrees_of_freedom])
    )
    limit = t_quantile(float(combined_degrees)) * float(np.sqrt(variances.sum()))
    return mean / limit if limit > 0 else 0.0


def open_ends(profiles: Iterable[Profile], quantity: Callable[[np.ndarray], float]) -> tuple[bool, bool]:
    """Tell whether something falls, and whether it rises, beyond ends of profiles; see `Profile.beyond`."""
    ends = [curve.open_ends(quantity) for curve in profiles]
    return any(open_below for open_below, _ in ends), any(open_above for _, open_above in ends)
