"""What follows from the parameters: quantities with the intervals that parameters hand on to them."""

from collections.abc import Mapping, Sequence
from math import exp, log

import numpy as np

from hitchid.estimation import Objective
from hitchid.model.estimates import MAX_INTERVAL_RATIO, Quantity
from hitchid.uncertainty.influence import Influence
from hitchid.uncertainty.profile import Profile, open_ends

RELATIVE_PERTURBATION = 0.01
GRADIENT_STEP = 1e-4
TINY = 1e-300


def derived(
    objective: Objective,
    position: np.ndarray,
    influence: Influence,
    profiles: Sequence[Profile],
    units: Mapping[str, str],
) -> tuple[Quantity, ...]:
    """Return what follows from the parameters, as far as the tests allow it.

    The interval is carried over along the slope of the quantity's logarithm, and widened to all that a
    profile allows; where a profile has no end and takes the quantity with it, the interval has none.

    Args:
        objective: tests and form.
        position: the estimates, shape [D].
        influence: how far they would move with other tests.
        profiles: of those that are not determined.
        units: `x` and `u` to the units of displacement and command.
    """
    dead_zone = float(objective.batch.dead_zone[0])

    def quantities_at(point: np.ndarray) -> dict[str, tuple[float, str]]:
        return objective.spec.derived(objective.values(point), dead_zone)

    best = quantities_at(position)
    perturbed = [
        (quantities_at(position + step), quantities_at(position - step))
        for step in GRADIENT_STEP * np.eye(position.size)
    ]
    allowed = [quantities_at(point) for profile in profiles for point in profile.positions[profile.allowed]]
    # A combination is no surer than the least sure of what goes into it; one at a bound moves nothing.
    degrees = float(
        np.min(
            influence.degrees_of_freedom[influence.degrees_of_freedom > 1], initial=len(influence.by_test) - 1
        )
    )
    quantities = []
    for name, (value, unit) in best.items():
        gradient = [
            (_log(above[name][0]) - _log(below[name][0])) / (2 * GRADIENT_STEP) for above, below in perturbed
        ]
        half_width = influence.half_width(np.array(gradient), degrees)
        candidates = [
            _log(value) - half_width,
            _log(value) + half_width,
            *(_log(quantity_values[name][0]) for quantity_values in allowed),
        ]
        open_below, open_above = open_ends(
            profiles, lambda point, name=name: _log(quantities_at(point)[name][0])
        )
        lower = None if open_below else _exp(min(candidates))
        upper = None if open_above else _exp(max(candidates))
        narrow = lower is not None and upper is not None and upper <= MAX_INTERVAL_RATIO * lower
        quantities.append(Quantity(name, unit.format(**units), value, (lower, upper), narrow))
    return tuple(quantities)


def _log(value: float) -> float:
    return log(max(value, TINY))


def _exp(logarithm: float) -> float | None:
    """Return the number that has a logarithm; None, an open end, where no number of double precision has."""
    return exp(logarithm) if abs(logarithm) < -log(TINY) else None


def sensitivities(objective: Objective, position: np.ndarray) -> tuple[float, ...]:
    """Return the mean relative change of the RMSE for ±1 % of each parameter (Sun et al. 2025, sec. 3.1.1).

    Args:
        objective: tests and form.
        position: the estimates, shape [D].
    """
    values, pooled = objective.values(position), objective.pooled()
    best, changes = pooled.error(position), []
    for factors in np.eye(position.size) * RELATIVE_PERTURBATION:
        perturbed_errors = [
            pooled.error(objective.bounds.unclipped_position(values * (1 + sign * factors)))
            for sign in (1, -1)
        ]
        changes.append(float(np.mean(np.abs(np.array(perturbed_errors) - best) / best)))
    return tuple(changes)
