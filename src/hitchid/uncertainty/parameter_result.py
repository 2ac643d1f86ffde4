"""Uncertainty of one parameter while it is assessed."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import pi

import numpy as np
from jaxtyping import Float

from hitchid.estimation import Objective
from hitchid.model.estimates import MAX_INTERVAL_RATIO, Interval
from hitchid.structures import Parameter
from hitchid.uncertainty.profile import Profile, open_ends
from hitchid.uncertainty.scores import Scores

# Verdict on a parameter: determined or not, its interval, and the excitation that would determine it.


def verdict(
    parameter: Parameter,
    unit: str,
    interval: Interval,
    *,
    determined: bool,
    bound: str,
    conditional_on: Sequence[str] = (),
    fallback_quantity: str,
    step_s: float,
    stands_for: str = "",
) -> str:
    """Return as text whether tests determine a parameter, its interval, and the excitation required."""
    if determined:
        return f"determined as {stands_for}" if stands_for else "determined"
    if conditional_on:
        return f"determined only for {' and '.join(conditional_on)} at its bound"
    # Where another quantity is determined instead, no excitation is advised.
    hint = "" if fallback_quantity else _excitation_hint(parameter, interval, step_s)
    text = "; ".join(filter(None, (_range_text(parameter, unit, interval), hint)))
    if fallback_quantity:
        return f"only {fallback_quantity} is determined: {text}"
    # Where all values between the bounds fit, that the estimate is at one of them says nothing.
    if bound and interval != (None, None):
        return f"at its {bound} bound: {text}"
    return f"not determined: {text}"


def _range_text(parameter: Parameter, unit: str, interval: Interval) -> str:
    name = parameter.symbol or parameter.name.replace("_", " ")
    unit_suffix = "" if unit == "1" else f" {unit}"
    lower, upper = interval
    if lower is not None and upper is not None:
        return f"{name} from {lower:.3g} to {upper:.3g}{unit_suffix} at 95 %"
    if lower is not None:
        return f"{name} > {lower:.3g}{unit_suffix} at 95 %"
    if upper is not None:
        return f"{name} < {upper:.3g}{unit_suffix} at 95 %"
    return f"all values of {name} between the bounds fit equally well"


def _excitation_hint(parameter: Parameter, interval: Interval, step_s: float) -> str:
    """Return the excitation that would determine a parameter; its corner frequency for times, frequencies."""
    lower, upper = interval
    nyquist_rad_s = pi / step_s
    # Beyond half the sampling frequency no excitation helps.
    frequency_too_high = parameter.unit == "rad/s" and lower is not None and lower > nyquist_rad_s
    time_too_short = parameter.unit == "s" and upper is not None and upper < 1 / nyquist_rad_s
    if frequency_too_high or time_too_short:
        return f"faster than can be identified at a sampling time of {step_s:.3g} s"
    if parameter.unit == "rad/s" and lower is not None and upper is None:
        return f"excite above {lower / (2 * pi):.2g} Hz"
    if parameter.unit == "rad/s" and upper is not None and lower is None:
        return f"excite below {upper / (2 * pi):.2g} Hz"
    if parameter.unit == "s" and upper is not None and lower is None:
        return f"excite above {1 / (2 * pi * upper):.2g} Hz"
    if parameter.unit == "s" and lower is not None and upper is None:
        return f"excite below {1 / (2 * pi * lower):.2g} Hz"
    return parameter.excitation_hint


AT_BOUND = 1e-3  # distance from a bound, in the unit cube, below which an estimate lies at it; chosen
MAX_LINEAR_SHARE = 0.5  # width of a determined interval over the search range, linear parameters; chosen


@dataclass(frozen=True)
class ParameterResult:
    """Uncertainty of one parameter.

    Attributes:
        number, parameter: index and definition of the parameter.
        lower, upper, linear: search bounds; whether the search scale is linear (else logarithmic).
        bound: `lower` or `upper` where the estimate lies at one, else empty.
        insensitive: whether the simulation depends on it too little for a standard error.
        interval: 95 % confidence interval.
        profile: the profile that gives the interval; None for a Gauss-Newton interval.
        conditional_on: symbols of the parameters at a bound for which alone the interval holds.
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
    conditional_on: tuple[str, ...] = ()

    @classmethod
    def of(cls, objective: Objective, position: np.ndarray, number: int) -> "ParameterResult":
        """Return the bounds of one parameter, and whether its estimate lies at one."""
        coordinate = float(position[number])
        return cls(
            number=number,
            parameter=objective.spec.parameters[number],
            lower=float(objective.bounds.lower[number]),
            upper=float(objective.bounds.upper[number]),
            linear=bool(objective.bounds.linear[number]),
            bound="lower" if coordinate < AT_BOUND else "upper" if coordinate > 1 - AT_BOUND else "",
        )

    def value(self, coordinate: float) -> float:
        """Return the parameter value at a coordinate of the unit interval."""
        if self.linear:
            return self.lower + coordinate * (self.upper - self.lower)
        return self.lower * (self.upper / self.lower) ** coordinate

    def to_interval(self, lower: float | None, upper: float | None) -> Interval:
        """Return the parameter values at two coordinates; an end outside the bounds is open (None)."""
        return (
            None if lower is None or not lower >= 0 else self.value(lower),
            None if upper is None or not upper <= 1 else self.value(upper),
        )

    def to_coordinate(self, value: float) -> float:
        """Return the coordinate of a parameter value; the inverse of `value`."""
        if self.linear:
            return (value - self.lower) / (self.upper - self.lower)
        return float(np.log(value / self.lower) / np.log(self.upper / self.lower))

    @property
    def search_range(self) -> float:
        """Width of the search range: upper − lower, log(upper/lower) on a logarithmic scale."""
        return self.upper - self.lower if self.linear else float(np.log(self.upper / self.lower))

    @property
    def profile_points(self) -> tuple[tuple[float, float], ...]:
        """Its profile as pairs of value and RMSE; empty for a Gauss-Newton interval."""
        if self.profile is None:
            return ()
        points = zip(self.profile.positions[:, self.number], self.profile.fitness, strict=True)
        return tuple((self.value(float(coordinate)), float(fitness)) for coordinate, fitness in points)

    def with_open_ends(self, profiles: Iterable[Profile]) -> "ParameterResult":
        """Return it with an end open where it follows another parameter along an open end of its profile."""
        others = (curve for curve in profiles if curve.number != self.number)
        open_below, open_above = open_ends(
            others, lambda point: self.search_range * float(point[self.number])
        )
        lower, upper = self.interval
        interval = None if open_below else lower, None if open_above else upper
        return replace(self, interval=interval)

    @property
    def symbol(self) -> str:
        """Symbol of the parameter, or its name."""
        return self.parameter.symbol or self.parameter.name.replace("_", " ")

    def is_narrow(
        self, interval: Interval, factor: float = MAX_INTERVAL_RATIO, share: float = MAX_LINEAR_SHARE
    ) -> bool:
        """Return whether upper/lower is at most `factor`; on a linear scale, the width at most `share`."""
        lower, upper = interval
        if lower is None or upper is None:
            return False
        return upper - lower <= share * (self.upper - self.lower) if self.linear else upper <= factor * lower

    @property
    def determined(self) -> bool:
        """Whether the interval is closed and narrow, the estimate not at a bound nor conditional on one."""
        return not self.bound and not self.conditional_on and self.is_narrow(self.interval)


# Intervals of parameters that depend on another parameter at a bound of its search.

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
    # With zero among them, so that an interval is widened and never narrowed.
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
    to_zero = (other.lower if other.linear else 1.0) / other.search_range if other.lower >= 0 else MAX_STEP
    furthest = (-min(MAX_STEP, to_zero), 0.0) if other.bound == "lower" else (0.0, MAX_STEP)
    step[columns] = np.clip(change, *furthest) * tangent
    return step
