"""From a best position to what is known of it: errors, intervals, profiles where they are wide, verdicts."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hitchid.fitting import Misfit
from hitchid.uncertainty.dead_zone_error import KNOWN, DeadZoneError
from hitchid.uncertainty.derived import derived, sensitivities
from hitchid.uncertainty.estimate import NARROW, Estimate, Estimates, Interval
from hitchid.uncertainty.moves import Moves, moves
from hitchid.uncertainty.profile import Profile, beyond, profile
from hitchid.uncertainty.words import verdict

AT_BOUND = 1e-3
HALF = 0.5
TIGHT, LITTLE = 1.4, 0.2
TAILS = (2.5, 97.5)


class _Ends(NamedTuple):
    """Ends of an interval between the bounds, None where the tests give none, and how they were found."""

    lower: float | None
    upper: float | None
    profile: Profile | None = None


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
    free = (position > AT_BOUND) & (position < 1 - AT_BOUND)
    position = np.where(free, position, np.round(position))
    moved = moves(misfit, position, free, dead_zone, seed=seed)
    ends = [_ends(misfit, position, moved, number, free, dead_zone) for number in range(position.size)]
    profiles = [each.profile for each in ends if each.profile]
    intervals = [
        _opened(_interval(misfit, number, each), misfit, profiles, number) for number, each in enumerate(ends)
    ]
    parameters = misfit.form.parameters
    sure = [
        _narrow(misfit, number, interval) and bool(free[number]) for number, interval in enumerate(intervals)
    ]
    quantities = derived(misfit, position, moved, profiles, units)
    names = {quantity.name: quantity.name for quantity in quantities if quantity.determined}
    names |= {p.name: p.symbol for p, told in zip(parameters, sure, strict=True) if told}
    together = misfit.form.structure.instead
    values, slopes = misfit.values(position), misfit.slopes(position)
    changes = sensitivities(misfit, position)
    estimates = []
    for number, (parameter, interval) in enumerate(zip(parameters, intervals, strict=True)):
        unit = parameter.unit.format(**units)
        along = np.eye(position.size)[number]
        tails = np.clip(position[number] + np.percentile(moved.redrawn[:, number], TAILS), 0.0, 1.0)
        found = ends[number].profile
        curve = (
            ()
            if found is None
            else tuple(
                (float(misfit.values(each)[number]), float(fitness))
                for each, fitness in zip(found.positions, found.fitness, strict=True)
            )
        )
        estimates.append(
            Estimate(
                name=parameter.name,
                symbol=parameter.symbol or parameter.name.replace("_", " "),
                unit=unit,
                value=float(values[number]),
                error=float(slopes[number] * moved.error(along)) if free[number] else None,
                interval=interval,
                method="Gauss-Newton" if found is None else "profile",
                bootstrap=_interval(misfit, number, _Ends(float(tails[0]), float(tails[1])))
                if free[number]
                else None,
                lower=float(misfit.lower[number]),
                upper=float(misfit.upper[number]),
                linear=parameter.linear,
                determined=sure[number],
                verdict=verdict(
                    parameter,
                    unit,
                    interval,
                    determined=sure[number],
                    bound="" if free[number] else ("lower" if position[number] < HALF else "upper"),
                    instead=""
                    if _narrow(misfit, number, interval)
                    else names.get(together.get(parameter.name, ""), ""),
                    step_s=misfit.batch.step_s,
                ),
                sensitivity=changes[number],
                profile=curve,
            )
        )
    known = Estimates(
        parameters=tuple(estimates),
        derived=quantities,
        correlation=_correlation(moved),
        tests=int(np.sum(np.asarray(misfit.batch.counted).any(axis=1))),
        rows=len(moved.by_test),
    )
    return known, moved


def _ends(
    misfit: Misfit,
    position: np.ndarray,
    moved: Moves,
    number: int,
    free: np.ndarray,
    dead_zone: DeadZoneError,
) -> _Ends:
    """Return the interval of Gauss and Newton, or the profile's where that is wide or meets a bound."""
    along = np.eye(position.size)[number]
    if free[number]:
        reach = moved.reach(along, float(moved.degrees[number]))
        ends = _Ends(float(position[number] - reach), float(position[number] + reach))
        inside = ends.lower is not None and ends.lower > 0 and ends.upper is not None and ends.upper < 1
        if inside and _narrow(misfit, number, _interval(misfit, number, ends), TIGHT, LITTLE):
            return ends
    found = profile(misfit, position, number, dead_zone)
    return _Ends(found.lower, found.upper, found)


def _interval(misfit: Misfit, number: int, ends: _Ends) -> Interval:
    """Return an interval's ends as values of the parameter."""
    return _value(misfit, number, ends.lower), _value(misfit, number, ends.upper)


def _opened(interval: Interval, misfit: Misfit, profiles: Sequence[Profile], number: int) -> Interval:
    """Return an interval without the ends beyond which a parameter goes with another that is left free."""

    def told(place: np.ndarray) -> float:
        value = float(misfit.values(place)[number])
        return value if bool(misfit.linear[number]) else float(np.log(value))

    falls, rises = beyond((each for each in profiles if each.number != number), told)
    return None if falls else interval[0], None if rises else interval[1]


def _value(misfit: Misfit, number: int, place: float | None) -> float | None:
    if place is None:
        return None
    return float(misfit.values(np.full(len(misfit.form.parameters), place))[number])


def _narrow(
    misfit: Misfit, number: int, interval: Interval, factor: float = NARROW, share: float = HALF
) -> bool:
    """Tell whether an interval is within a factor, or around zero within a share of the room."""
    lower, upper = interval
    if lower is None or upper is None:
        return False
    if bool(misfit.linear[number]):
        return upper - lower <= share * float(misfit.upper[number] - misfit.lower[number])
    return upper <= factor * lower


def _correlation(moved: Moves) -> tuple[tuple[float, ...], ...]:
    covariance = moved.covariance
    sizes = np.sqrt(np.diag(covariance))
    scale = np.where(sizes > 0, sizes, 1.0)
    return tuple(tuple(map(float, row)) for row in covariance / np.outer(scale, scale))
