"""Profiles: one parameter held at a value, all others fitted, until the tests contradict it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hitchid.estimation import Misfit, polish_some
from hitchid.uncertainty.dead_zone_error import KNOWN, DeadZoneError, degrees_together, student
from hitchid.uncertainty.scores import Scores

FIRST = 0.02
HALVINGS = 4
STEPS, TOLERANCE = 5, 1e-4
FEWEST = 4
STEP, GOES, FASTEST = 1e-4, 0.1, 10.0
# A share of the squared misses that no number of samples makes significant: slopes below are rounding.
LEAST_FALL = 1e-9


class Profile(NamedTuple):
    """What the tests say of one parameter, wherever the interval of Gauss and Newton is wide.

    Attributes:
        number: which parameter was held.
        lower, upper: ends of the 95 % interval, positions between the bounds; None where the tests allow a
            bound that is none but the search's.
        positions: where it was held, ascending, with all others fitted, shape [K, D].
        fitness: root mean square of the misses there, shape [K].
        allowed: whether the tests allow it, ends of the interval included, shape [K].
        along: how the others follow it, shape [K, D].
        room: between the bounds, as a difference of logarithms where the search runs in these, else 1.
    """

    number: int
    lower: float | None
    upper: float | None
    positions: np.ndarray
    fitness: np.ndarray
    allowed: np.ndarray
    along: np.ndarray
    room: float

    def beyond(self, told: Callable[[np.ndarray], float]) -> tuple[bool, bool]:
        """Tell whether something falls, and whether it rises, where the tests leave this parameter free.

        At an end that is a bound of the search alone the parameter might as well go farther; what goes with
        it by more than a tenth of its own pace is no better known than it is. What would follow at more than
        ten times its pace hardly moves the model, and counts with that.

        Args:
            told: from a position, shape [D], to a number, or to its logarithm where that is positive.
        """
        ends = [(0, -STEP)] * (self.lower is None) + [(-1, STEP)] * (self.upper is None)
        falls = rises = False
        for number, step in ends:
            end = self.positions[number]
            outward = step * np.clip(self.along[number], -FASTEST, FASTEST)
            pace = (told(end + outward) - told(end - outward)) / (2 * STEP * self.room)
            falls, rises = falls or pace < -GOES, rises or pace > GOES
        return falls, rises


def profile(misfit: Misfit, position: np.ndarray, number: int, dead_zone: DeadZoneError = KNOWN) -> Profile:
    """Find what values of one parameter the tests do not contradict.

    A value is contradicted where, all others fitted, the tests agree that another would be better: where the
    mean over tests of the slope along the parameter lies farther from zero than Student's t has it at 95 %,
    or, for the slope levels off far away, where the tests are fitted worse than at the best position by a
    mean that far from zero. That holds however the errors within a test are correlated, and where the
    parameter goes to infinity. It is the score test of Rao (1948, Math. Proc. Camb. Phil. Soc. 44, 50) with
    tests as what is drawn.

    Args:
        misfit: the tests.
        position: the best position, shape [D].
        number: which parameter.
        dead_zone: how well it is known; its error moves all tests together.
    """
    others = [each for each in range(position.size) if each != number]
    held: list[_Held] = []
    around = [misfit] if dead_zone.size == 0 else [misfit, dead_zone.beside(misfit)]
    best_errors = [each.by_test(position) for each in around]

    def hold(place: float, start: np.ndarray) -> _Held:
        moved = start.copy()
        moved[number] = place
        if others and place != position[number]:
            moved[others] = polish_some(misfit, others, [moved], STEPS, TOLERANCE).position
        held.append(_Held.at(around, moved, number, dead_zone, best_errors))
        return held[-1]

    def between(inside: float, outside: float, start: np.ndarray) -> float:
        for _ in range(HALVINGS):
            middle = 0.5 * (inside + outside)
            found = hold(middle, start)
            inside, outside, start = (
                (inside, middle, found.position) if found.excess > 1 else (middle, outside, found.position)
            )
        return outside

    def end(bound: float) -> float | None:
        """Return the last place toward a bound that is not contradicted; None where the bound is not."""
        inside, start, width = float(position[number]), position, FIRST
        sign = np.sign(bound - inside)
        while inside != bound:
            place = float(np.clip(inside + sign * width, 0.0, 1.0))
            found = hold(place, start)
            if found.excess > 1:
                return between(inside, place, found.position)
            inside, start, width = place, found.position, 2 * width
        return None

    best = replace(hold(float(position[number]), position), excess=0.0)
    lower, upper = end(0.0), end(1.0)
    if misfit.form.parameters[number].name in misfit.form.bounds:
        lower, upper = lower or 0.0, 1.0 if upper is None else upper
    bounds = float(misfit.bounds.lower[number]), float(misfit.bounds.upper[number])
    ordered = sorted([best, *held[1:]], key=lambda each: float(each.position[number]))
    return Profile(
        number=number,
        lower=lower,
        upper=upper,
        positions=np.stack([each.position for each in ordered]),
        fitness=np.array([each.fitness for each in ordered]),
        allowed=np.array([each.excess <= 1 or each.position[number] in (lower, upper) for each in ordered]),
        along=np.stack([each.along for each in ordered]),
        room=1.0 if bool(misfit.bounds.linear[number]) else float(np.log(bounds[1] / bounds[0])),
    )


@dataclass(frozen=True)
class _Held:
    """One parameter held at a value: where the others end, by how much tests contradict it, 1 the limit."""

    position: np.ndarray
    fitness: float
    excess: float
    along: np.ndarray

    @classmethod
    def at(
        cls,
        around: Sequence[Misfit],
        position: np.ndarray,
        number: int,
        dead_zone: DeadZoneError,
        best_errors: Sequence[np.ndarray],
    ) -> "_Held":
        """Hold a parameter at a position; `around` is the misfit, and that beside the dead zone."""
        scores, *beside = [Scores.of(misfit, position) for misfit in around]
        along = scores.along(number)
        slopes = scores.slopes @ along
        shift = sum((float((other.slopes @ along).sum() - slopes.sum()) for other in beside), 0.0)
        left = slopes.size - position.size
        errors, *others = [misfit.by_test(position) for misfit in around]
        excess = 0.0
        if slopes.sum() ** 2 > LEAST_FALL * (along @ scores.curvature @ along) * around[0].cost(position):
            excess = _contradicted(abs(float(slopes.mean())), slopes, shift / slopes.size, left, dead_zone)
        worse, *moved = [own - best for own, best in zip((errors, *others), best_errors, strict=True)]
        if worse.size >= FEWEST:
            mean = float(worse.mean())
            shift = sum((float(other.mean()) - mean for other in moved), 0.0)
            excess = max(excess, _contradicted(mean, worse, shift, worse.size - 1, dead_zone))
        fitness = float(np.sqrt(np.mean(errors[errors > 0] ** 2)))
        return cls(position, fitness, excess, along)


def _contradicted(
    mean: float, drawn: np.ndarray, shift: float, degrees: int, dead_zone: DeadZoneError
) -> float:
    """Return how far a mean over tests lies from zero, 1 where Student's t has its limit at 95 %.

    Args:
        mean: of what the tests say.
        drawn: what each of them says.
        shift: what a standard error of the dead zone adds to the mean.
        degrees: of freedom of the tests' spread.
        dead_zone: how well it is known.
    """
    variances = np.array([drawn.var(ddof=1) / drawn.size, shift**2])
    known = degrees_together(variances, np.array([max(degrees, 1), dead_zone.degrees]))
    spread = student(float(known)) * float(np.sqrt(variances.sum()))
    return mean / spread if spread > 0 else 0.0


def beyond(profiles: Iterable[Profile], told: Callable[[np.ndarray], float]) -> tuple[bool, bool]:
    """Tell whether something falls, and whether it rises, beyond ends of profiles; see `Profile.beyond`."""
    found = [each.beyond(told) for each in profiles]
    return any(falls for falls, _ in found), any(rises for _, rises in found)
