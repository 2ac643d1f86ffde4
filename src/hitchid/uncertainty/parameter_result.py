"""Uncertainty of one parameter while it is assessed."""

from dataclasses import dataclass

import numpy as np

from hitchid.estimation import Objective
from hitchid.model.estimates import MAX_INTERVAL_RATIO, Interval
from hitchid.structures import Parameter
from hitchid.uncertainty.profile import Profile

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
