"""Quantities derived from the parameters, with intervals by error propagation and profiles."""

from collections.abc import Mapping, Sequence
from math import exp, log

import numpy as np

from hitchid.estimation import Objective
from hitchid.model.estimates import MAX_INTERVAL_RATIO, Quantity
from hitchid.uncertainty.influence import Influence
from hitchid.uncertainty.profile import Profile, open_ends

RELATIVE_PERTURBATION = 0.01  # of a parameter, for its sensitivity (Sun et al. 2025)
GRADIENT_STEP = 1e-4  # of central differences, in the unit cube; chosen
TINY = 1e-300  # smallest argument of a logarithm


def derived(
    objective: Objective,
    position: np.ndarray,
    influence: Influence,
    profiles: Sequence[Profile],
    units: Mapping[str, str],
) -> tuple[Quantity, ...]:
    """Return the derived quantities of the structure with their 95 % intervals.

    The interval follows from the gradient of the quantity's logarithm, widened to the range over the allowed
    points of the profiles; it is open where the quantity follows a parameter beyond an open end of a profile.

    Args:
        objective: tests and model specification.
        position: the estimates in the unit cube, shape [D].
        influence: influence of the tests on the estimates.
        profiles: of the parameters whose Gauss-Newton interval is wide.
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
    # Conservative: the smallest degrees of freedom of any free parameter; those at a bound have 1.
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
    """Return the exponential; None, an open end, outside the range of double precision."""
    return exp(logarithm) if abs(logarithm) < -log(TINY) else None


def sensitivities(objective: Objective, position: np.ndarray) -> tuple[float, ...]:
    """Return the mean relative change of the RMSE for ±1 % of each parameter (Sun et al. 2025, sec. 3.1.1).

    Args:
        objective: tests and model specification.
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
