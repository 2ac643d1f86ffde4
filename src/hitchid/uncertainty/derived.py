"""What follows from the parameters: quantities with the intervals that parameters hand on to them."""

from collections.abc import Mapping, Sequence
from math import exp, log

import numpy as np

from hitchid.estimation import Misfit
from hitchid.uncertainty.estimate import NARROW, Quantity
from hitchid.uncertainty.moves import Moves
from hitchid.uncertainty.profile import Profile, beyond

PERTURBATION = 0.01
STEP = 1e-4
LEAST = 1e-300


def derived(
    misfit: Misfit,
    position: np.ndarray,
    moved: Moves,
    profiles: Sequence[Profile],
    units: Mapping[str, str],
) -> tuple[Quantity, ...]:
    """Return what follows from the parameters, as far as the tests allow it.

    The interval is carried over along the slope of the quantity's logarithm, and widened to all that a
    profile allows; where a profile has no end and takes the quantity with it, the interval has none.

    Args:
        misfit: tests and form.
        position: the estimates, shape [D].
        moved: how far they would move with other tests.
        profiles: of those that are not determined.
        units: `x` and `u` to the units of displacement and command.
    """
    dead_zone = float(misfit.batch.dead_zone[0])

    def at(place: np.ndarray) -> dict[str, tuple[float, str]]:
        return misfit.form.derived(misfit.values(place), dead_zone)

    best = at(position)
    around = [(at(position + step), at(position - step)) for step in STEP * np.eye(position.size)]
    allowed = [at(place) for each in profiles for place in each.positions[each.allowed]]
    # A combination is no surer than the least sure of what goes into it; one at a bound moves nothing.
    degrees = float(np.min(moved.degrees[moved.degrees > 1], initial=len(moved.by_test) - 1))
    quantities = []
    for name, (value, unit) in best.items():
        along = [(_log(ahead[name][0]) - _log(behind[name][0])) / (2 * STEP) for ahead, behind in around]
        reach = moved.reach(np.array(along), degrees)
        found = [_log(value) - reach, _log(value) + reach, *(_log(each[name][0]) for each in allowed)]
        falls, rises = beyond(profiles, lambda place, name=name: _log(at(place)[name][0]))
        lower = None if falls else _exp(min(found))
        upper = None if rises else _exp(max(found))
        narrow = lower is not None and upper is not None and upper <= NARROW * lower
        quantities.append(Quantity(name, unit.format(**units), value, (lower, upper), narrow))
    return tuple(quantities)


def _log(value: float) -> float:
    return log(max(value, LEAST))


def _exp(logarithm: float) -> float | None:
    """Return the number that has a logarithm; None, an open end, where no number of double precision has."""
    return exp(logarithm) if abs(logarithm) < -log(LEAST) else None


def sensitivities(misfit: Misfit, position: np.ndarray) -> tuple[float, ...]:
    """Return the mean relative change of the RMSE for ±1 % of each parameter (Sun et al. 2025, sec. 3.1.1).

    Args:
        misfit: tests and form.
        position: the estimates, shape [D].
    """
    values, pooled = misfit.values(position), misfit.pooled()
    best, changes = pooled.error(position), []
    for factors in np.eye(position.size) * PERTURBATION:
        around = [pooled.error(misfit.bounds.place(values * (1 + sign * factors))) for sign in (1, -1)]
        changes.append(float(np.mean(np.abs(np.array(around) - best) / best)))
    return tuple(changes)
