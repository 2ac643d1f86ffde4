"""From a best position to what is known of it: errors, intervals, profiles where they are wide, verdicts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchid.estimation import Misfit
from hitchid.structures import Parameter
from hitchid.uncertainty.dead_zone_error import KNOWN, DeadZoneError
from hitchid.uncertainty.derived import derived, sensitivities
from hitchid.uncertainty.estimate import NARROW, Estimate, Estimates, Interval, Quantity
from hitchid.uncertainty.moves import Moves, moves
from hitchid.uncertainty.profile import Profile, beyond, profile
from hitchid.uncertainty.words import verdict

AT_BOUND = 1e-3
HALF = 0.5
TIGHT, LITTLE = 1.4, 0.2
TAILS = (2.5, 97.5)
PROFILED = 2048
# Share of the largest derivative: below it an error of a thousandth of the travel is wider than the bounds.
INSENSITIVE = 1e-5


@dataclass(frozen=True)
class _Found:
    """What was found of one parameter.

    Attributes:
        number, parameter: which.
        lower, upper, linear: bounds of its search, and whether that runs between them as they are.
        bound: `lower` or `upper` where the estimate lies at one, else empty.
        insensitive: whether the tests change so little with it that no error can be computed.
        interval: 95 %.
        profile: where the interval comes from one.
    """

    number: int
    parameter: Parameter
    lower: float
    upper: float
    linear: bool
    bound: str
    insensitive: bool = False
    interval: Interval = (None, None)
    profile: Profile | None = None

    @classmethod
    def of(cls, misfit: Misfit, position: np.ndarray, number: int) -> "_Found":
        """Start with an estimate's bounds."""
        place = float(position[number])
        return cls(
            number=number,
            parameter=misfit.form.parameters[number],
            lower=float(misfit.bounds.lower[number]),
            upper=float(misfit.bounds.upper[number]),
            linear=bool(misfit.bounds.linear[number]),
            bound="lower" if place < AT_BOUND else "upper" if place > 1 - AT_BOUND else "",
        )

    def value(self, place: float) -> float:
        """Return the value at a place between the bounds."""
        if self.linear:
            return self.lower + place * (self.upper - self.lower)
        return self.lower * (self.upper / self.lower) ** place

    def between(self, lower: float | None, upper: float | None) -> Interval:
        """Return the values of two places; an end beyond the bounds is open."""
        return (
            None if lower is None or not lower >= 0 else self.value(lower),
            None if upper is None or not upper <= 1 else self.value(upper),
        )

    def narrow(self, interval: Interval, factor: float = NARROW, share: float = HALF) -> bool:
        """Tell whether an interval is within a factor, or around zero within a share of the room."""
        lower, upper = interval
        if lower is None or upper is None:
            return False
        return upper - lower <= share * (self.upper - self.lower) if self.linear else upper <= factor * lower

    @property
    def determined(self) -> bool:
        """Whether the interval is closed and narrow, and the estimate not at a bound."""
        return not self.bound and self.narrow(self.interval)


def assess(
    misfit: Misfit,
    position: np.ndarray,
    *,
    units: Mapping[str, str],
    dead_zone: DeadZoneError = KNOWN,
    seed: int = 0,
) -> tuple[Estimates, Moves]:
    """Say how well the tests determine each parameter of a form.

    Intervals are those of Gauss and Newton, between the bounds in the coordinates of the search (logarithms
    of what is positive), with tests taken as independent and the samples of one test not. Where such an
    interval is wide or meets a bound, a profile takes its place. A parameter is determined where its interval
    is closed and no wider than a factor of three, or half the room between its bounds where that holds zero.

    Args:
        misfit: identification tests and form.
        position: the best position in the unit cube, shape [D].
        units: `x` and `u` to the units of displacement and command.
        dead_zone: how well it is known.
        seed: draws tests anew for the bootstrap.

    Returns:
        What is known, and by how much each test moves each estimate.
    """
    found = [_Found.of(misfit, position, number) for number in range(position.size)]
    inside = np.array([not each.bound for each in found])
    position = np.where(inside, position, np.round(position))
    seen = np.sqrt(np.einsum("tdd->d", misfit.equations_by_test(position).curvatures))
    found = [
        replace(each, insensitive=bool(own < INSENSITIVE * seen.max()))
        for each, own in zip(found, seen, strict=True)
    ]
    free = np.array([not (each.bound or each.insensitive) for each in found])
    moved = moves(misfit, position, free, dead_zone, seed=seed)
    found = [_with_interval(each, misfit, position, moved, dead_zone) for each in found]
    profiles = [each.profile for each in found if each.profile is not None]
    found = [replace(each, interval=_opened(each, profiles)) for each in found]
    quantities = derived(misfit, position, moved, profiles, units)
    known = Estimates(
        parameters=_estimates(found, misfit, position, moved, quantities, units),
        derived=quantities,
        correlation=_correlation(moved),
        tests=_tests(misfit),
        rows=len(moved.by_test),
    )
    return known, moved._replace(profiles=tuple(profiles))


def unassessed(
    misfit: Misfit, position: np.ndarray, *, units: Mapping[str, str], cause: str
) -> tuple[Estimates, Moves]:
    """Return estimates of which nothing but the value is known.

    Args:
        misfit, position, units: as for `assess`.
        cause: why, the verdict of every parameter.
    """
    values = misfit.values(position)
    estimates = tuple(
        Estimate(
            name=parameter.name,
            symbol=parameter.symbol or parameter.name.replace("_", " "),
            unit=parameter.unit.format(**units),
            value=float(values[number]),
            error=None,
            interval=(None, None),
            method="none",
            bootstrap=None,
            lower=float(misfit.bounds.lower[number]),
            upper=float(misfit.bounds.upper[number]),
            linear=bool(misfit.bounds.linear[number]),
            determined=False,
            verdict=cause,
            sensitivity=0.0,
        )
        for number, parameter in enumerate(misfit.form.parameters)
    )
    tests = _tests(misfit)
    nothing = tuple((0.0,) * position.size for _ in estimates)
    return Estimates(estimates, (), nothing, tests, tests), Moves.none(tests, position.size)


def _with_interval(
    found: _Found, misfit: Misfit, position: np.ndarray, moved: Moves, dead_zone: DeadZoneError
) -> _Found:
    """Return it with the interval of Gauss and Newton, or a profile's where that is wide or meets a bound.

    Of few tests the rows are stretches, which are not independent: the interval then holds the bootstrap's.
    """
    place = float(position[found.number])
    bootstrap = None
    if not (found.bound or found.insensitive):
        along = np.eye(position.size)[found.number]
        reach = moved.reach(along, float(moved.degrees[found.number]))
        interval = found.between(place - reach, place + reach)
        bootstrap = _redrawn(found, position, moved) if len(moved.by_test) > _tests(misfit) else None
        interval = _holding(interval, bootstrap)
        if found.narrow(interval, TIGHT, LITTLE):
            return replace(found, interval=interval)
    coarse = misfit.over(misfit.batch.thinned(PROFILED))
    curve = profile(coarse, position, found.number, dead_zone)
    interval = _holding(found.between(curve.lower, curve.upper), bootstrap)
    return replace(found, interval=interval, profile=curve)


def _holding(interval: Interval, other: Interval | None) -> Interval:
    """Return an interval that holds both; an open end stays so."""
    if other is None:
        return interval
    (lower, upper), (lowest, highest) = interval, other
    return (
        None if lower is None or lowest is None else min(lower, lowest),
        None if upper is None or highest is None else max(upper, highest),
    )


def _redrawn(found: _Found, position: np.ndarray, moved: Moves) -> Interval:
    """Return the 95 % interval from tests drawn anew."""
    tails = position[found.number] + np.percentile(moved.redrawn[:, found.number], TAILS)
    return found.between(*map(float, np.clip(tails, 0.0, 1.0)))


def _tests(misfit: Misfit) -> int:
    return int(np.sum(np.asarray(misfit.batch.counted).any(axis=1)))


def _opened(found: _Found, profiles: Sequence[Profile]) -> Interval:
    """Return an interval without the ends beyond which a parameter goes with another that is left free."""

    room = found.upper - found.lower if found.linear else float(np.log(found.upper / found.lower))

    def told(place: np.ndarray) -> float:
        return room * float(place[found.number])

    falls, rises = beyond((each for each in profiles if each.number != found.number), told)
    lower, upper = found.interval
    return None if falls else lower, None if rises else upper


def _estimates(
    found: Sequence[_Found],
    misfit: Misfit,
    position: np.ndarray,
    moved: Moves,
    quantities: Iterable[Quantity],
    units: Mapping[str, str],
) -> tuple[Estimate, ...]:
    """Return the estimates, each with its verdict."""
    told = {quantity.name: quantity.name for quantity in quantities if quantity.determined}
    told |= {each.parameter.name: each.parameter.symbol for each in found if each.determined}
    instead = misfit.form.structure.instead
    changes = sensitivities(misfit, position)
    values, slopes = misfit.values(position), misfit.slopes(position)
    estimates = []
    for each in found:
        number, parameter = each.number, each.parameter
        unit = parameter.unit.format(**units)
        standing_in = "" if each.narrow(each.interval) else told.get(instead.get(parameter.name, ""), "")
        estimates.append(
            Estimate(
                name=parameter.name,
                symbol=parameter.symbol or parameter.name.replace("_", " "),
                unit=unit,
                value=float(values[number]),
                error=None
                if each.bound or each.insensitive
                else float(slopes[number] * moved.errors[number]),
                interval=each.interval,
                method="Gauss-Newton" if each.profile is None else "profile",
                bootstrap=None if each.bound or each.insensitive else _redrawn(each, position, moved),
                lower=each.lower,
                upper=each.upper,
                linear=each.linear,
                determined=each.determined,
                verdict=verdict(
                    parameter,
                    unit,
                    each.interval,
                    determined=each.determined,
                    bound=each.bound,
                    instead=standing_in,
                    step_s=misfit.batch.step_s,
                ),
                sensitivity=changes[number],
                profile=_curve(each),
            )
        )
    return tuple(estimates)


def _curve(found: _Found) -> tuple[tuple[float, float], ...]:
    """Return the profile as pairs of value and RMSE."""
    if found.profile is None:
        return ()
    places = found.profile.positions[:, found.number]
    return tuple(
        (found.value(float(place)), float(fitness))
        for place, fitness in zip(places, found.profile.fitness, strict=True)
    )


def _correlation(moved: Moves) -> tuple[tuple[float, ...], ...]:
    scale = np.where(moved.errors > 0, moved.errors, 1.0)
    return tuple(tuple(map(float, row)) for row in moved.covariance / np.outer(scale, scale))
