"""Uncertainty of the estimates: standard errors, intervals, profiles, verdicts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import exp, log

import numpy as np

from hitchid._support.precision import parallel
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent, split_progress
from hitchid.estimation import Objective
from hitchid.model.estimates import MAX_INTERVAL_RATIO, NOT_ASSESSED, Estimate, Estimates, Interval, Quantity
from hitchid.structures import DEAD_TIME
from hitchid.uncertainty.influence import Influence, compute_influence
from hitchid.uncertainty.parameter_result import ParameterResult, over_parameters_at_bound, verdict
from hitchid.uncertainty.profile import Profile, open_ends, profile
from hitchid.uncertainty.scores import NO_ERROR, DeadZoneError

# Quantities derived from the parameters, with intervals by error propagation and profiles.

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
    inside = influence.degrees_of_freedom[influence.degrees_of_freedom > 1]
    degrees = float(np.min(inside, initial=len(influence.by_test) - 1))
    quantities = []
    for name, (value, unit) in best.items():
        gradient = [
            (_log(above[name][0]) - _log(below[name][0])) / (2 * GRADIENT_STEP) for above, below in perturbed
        ]
        # By the joint covariance: a combination is often determined much better than its parts.
        half_width = influence.half_width(np.array(gradient), degrees)
        in_profiles = [_log(quantity_values[name][0]) for quantity_values in allowed]
        candidates = [_log(value) - half_width, _log(value) + half_width, *in_profiles]
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
    """Return the mean relative change of the RMSE for ±1 % of each parameter (Sun et al. 2025, 3.1.1)."""
    # With one gain for all tests: a gain of each test's own would take up a perturbed one.
    values, pooled = objective.values(position), objective.pooled()
    best, changes = pooled.error(position), []
    for factors in np.eye(position.size) * RELATIVE_PERTURBATION:
        perturbed = [objective.bounds.unclipped_position(values * (1 + sign * factors)) for sign in (1, -1)]
        errors = np.array([pooled.error(perturbed_position) for perturbed_position in perturbed])
        changes.append(float(np.mean(np.abs(errors - best) / best)))
    return tuple(changes)


TIGHT_RATIO, TIGHT_SHARE = 1.4, 0.2  # widest interval without a profile: ratio, share of range; chosen
PERCENTILES = (2.5, 97.5)  # ends of a 95 % interval
ASSESSMENT_SHARES = {"standard errors": 0.3, "intervals": 0.5, "derived": 0.2}  # of the work (measured)
# Share of the largest derivative: below it an error of 0.1 % of the travel is wider than the bounds.
MIN_RELATIVE_DERIVATIVE = 1e-5
# Without a lag in the form, the dead time takes that of the plant, too.
DELAY_AND_LAG = "delay and lag together: this form has no lag"


def assess(
    objective: Objective,
    position: np.ndarray,
    *,
    units: Mapping[str, str],
    dead_zone: DeadZoneError = NO_ERROR,
    seed: int = 0,
    progress: ProgressCallback = silent,
) -> tuple[Estimates, Influence]:
    """Return standard error, 95 % interval and verdict of each parameter of a model.

    Intervals are Gauss-Newton intervals in the coordinates of the search (logarithmic for positive
    parameters), with a cluster-robust covariance: tests are independent, the samples of one test are not.
    A profile replaces an interval that is wide or reaches a bound. A parameter is determined if its interval
    is closed with upper/lower at most 3, or, on a linear scale, no wider than half its search range, and not
    conditional on another parameter at a bound; see `over_parameters_at_bound`.

    Args:
        objective: identification tests and model specification.
        position: the estimate in the unit cube, shape [D].
        units: `x` and `u` to the units of displacement and command.
        dead_zone: standard error of the dead zone.
        seed: of the bootstrap.
        progress: called with the current task and the completed fraction.

    Returns:
        The estimates, and the influence of each test on them.
    """
    results = [ParameterResult.of(objective, position, number) for number in range(position.size)]
    # A parameter at a bound is held exactly there for the intervals of the others.
    position = np.where([not result.bound for result in results], position, np.round(position))
    # A saturation far above every command, say, changes nothing: it has no standard error, and is fixed.
    norms = np.sqrt(np.einsum("tdd->d", objective.equations_by_test(position).curvatures))
    insensitive = (norms < MIN_RELATIVE_DERIVATIVE * norms.max()).tolist()
    results = [replace(result, insensitive=none) for result, none in zip(results, insensitive, strict=True)]
    free = np.array([not (result.bound or result.insensitive) for result in results])
    parts = split_progress(progress, ASSESSMENT_SHARES)
    parts["standard errors"](ProgressUpdate("standard errors of the parameters", 0.0))
    influence = compute_influence(objective, position, free, dead_zone, seed=seed)

    def with_interval(number: int) -> ParameterResult:
        name = results[number].parameter.name.replace("_", " ")
        parts["intervals"](ProgressUpdate("intervals of the parameters", number / len(results), name))
        return _with_interval(results[number], objective, position, influence, dead_zone)

    # In parallel, for the other direction may be done before: its core would wait.
    results = list(parallel(with_interval, range(len(results))).values())
    profiles = [result.profile for result in results if result.profile is not None]
    results = [result.with_open_ends(profiles) for result in results]
    results = over_parameters_at_bound(results, objective, position)
    parts["derived"](ProgressUpdate("quantities that follow from the parameters", 0.0))
    quantities = derived(objective, position, influence, profiles, units)
    estimates = Estimates(
        parameters=_estimates(results, objective, position, influence, quantities, units),
        derived=quantities,
        correlation=tuple(tuple(map(float, row)) for row in influence.correlation),
        tests=_count_tests(objective),
        rows=len(influence.by_test),
    )
    return estimates, influence._replace(profiles=tuple(profiles))


def unassessed(
    objective: Objective, position: np.ndarray, *, units: Mapping[str, str], cause: str
) -> tuple[Estimates, Influence]:
    """Return estimates without standard errors and intervals.

    Args:
        objective, position, units: as for `assess`.
        cause: why there are none; the verdict of every parameter.
    """
    estimates = _unassessed(objective, position, units, cause)
    tests = _count_tests(objective)
    no_correlation = tuple((0.0,) * position.size for _ in estimates)
    return Estimates(estimates, (), no_correlation, tests, tests), Influence.zeros(tests, position.size)


def _unassessed(
    objective: Objective, position: np.ndarray, units: Mapping[str, str], cause: str
) -> tuple[Estimate, ...]:
    values, bounds = objective.values(position), objective.bounds
    return tuple(
        Estimate(
            name=parameter.name,
            symbol=parameter.symbol or parameter.name.replace("_", " "),
            unit=parameter.unit.format(**units),
            value=float(values[number]),
            error=None,
            interval=(None, None),
            method=NOT_ASSESSED,
            bootstrap=None,
            lower=float(bounds.lower[number]),
            upper=float(bounds.upper[number]),
            linear=bool(bounds.linear[number]),
            determined=False,
            verdict=cause,
            sensitivity=0.0,
        )
        for number, parameter in enumerate(objective.spec.parameters)
    )


def _with_interval(
    result: ParameterResult,
    objective: Objective,
    position: np.ndarray,
    influence: Influence,
    dead_zone: DeadZoneError,
) -> ParameterResult:
    """Return the parameter with its Gauss-Newton interval, or a profile's if that is wide or reaches a bound.

    With few tests the rows are segments, which are not independent: the union with the bootstrap interval.
    """
    coordinate = float(position[result.number])
    bootstrap = None
    if not (result.bound or result.insensitive):
        unit_vector = np.eye(position.size)[result.number]
        half_width = influence.half_width(unit_vector, float(influence.degrees_of_freedom[result.number]))
        interval = result.to_interval(coordinate - half_width, coordinate + half_width)
        # Rows are then sections, whose errors are correlated within a test: alone the interval is too short.
        if len(influence.by_test) > _count_tests(objective):
            bootstrap = _bootstrap_interval(result, position, influence)
        interval = _interval_union(interval, bootstrap)
        if result.is_narrow(interval, TIGHT_RATIO, TIGHT_SHARE):
            return replace(result, interval=interval)
    # A profile needs no curvature, and holds where the parameter tends to infinity.
    coarse_objective = objective.with_data(objective.batch.coarse())
    curve = profile(coarse_objective, position, result.number, dead_zone)
    interval = _interval_union(result.to_interval(curve.lower, curve.upper), bootstrap)
    return replace(result, interval=interval, profile=curve)


def _interval_union(interval: Interval, other: Interval | None) -> Interval:
    """Return the smallest interval that contains both; an open end stays open."""
    if other is None:
        return interval
    (lower, upper), (lowest, highest) = interval, other
    return (
        None if lower is None or lowest is None else min(lower, lowest),
        None if upper is None or highest is None else max(upper, highest),
    )


def _bootstrap_interval(result: ParameterResult, position: np.ndarray, influence: Influence) -> Interval:
    """Return the 95 % bootstrap interval (percentiles)."""
    tails = position[result.number] + np.percentile(influence.bootstrap[:, result.number], PERCENTILES)
    return result.to_interval(*map(float, np.clip(tails, 0.0, 1.0)))


def _count_tests(objective: Objective) -> int:
    return int(np.sum(np.asarray(objective.batch.loss_mask).any(axis=1)))


def _estimates(
    results: Sequence[ParameterResult],
    objective: Objective,
    position: np.ndarray,
    influence: Influence,
    quantities: Iterable[Quantity],
    units: Mapping[str, str],
) -> tuple[Estimate, ...]:
    """Return one estimate per parameter, with its verdict."""
    determined_quantities = {quantity.name: quantity.name for quantity in quantities if quantity.determined}
    determined_quantities |= {
        result.parameter.name: result.parameter.symbol for result in results if result.determined
    }
    fallback_quantities = objective.spec.structure.fallback_quantity
    changes = sensitivities(objective, position)
    values, slopes = objective.values(position), objective.slopes(position)
    dead_time_stands_for = "" if objective.spec.has_lag(values) else DELAY_AND_LAG
    estimates = []
    for result, plain in zip(results, _unassessed(objective, position, units, ""), strict=True):
        number, parameter = result.number, result.parameter
        is_free = not (result.bound or result.insensitive)
        fallback_quantity = determined_quantities.get(fallback_quantities.get(parameter.name, ""), "")
        estimates.append(
            replace(
                plain,
                error=float(slopes[number] * influence.errors[number]) if is_free else None,
                interval=result.interval,
                method="Gauss-Newton" if result.profile is None else "profile",
                bootstrap=_bootstrap_interval(result, position, influence) if is_free else None,
                determined=result.determined,
                verdict=verdict(
                    parameter,
                    plain.unit,
                    result.interval,
                    determined=result.determined,
                    bound=result.bound,
                    conditional_on=result.conditional_on,
                    fallback_quantity="" if result.is_narrow(result.interval) else fallback_quantity,
                    step_s=objective.batch.step_s,
                    stands_for=dead_time_stands_for if parameter == DEAD_TIME else "",
                ),
                sensitivity=changes[number],
                profile=result.profile_points,
            )
        )
    return tuple(estimates)
