"""Wear: slow trends of gain, dead zone and leak in a change log, and when they reach a limit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.events import LEARNED, Event
from hitchid.errors import InputError

FEWEST = 5  # estimates from which a trend is fitted; chosen
STROKES_APART = 8  # of a direction between two estimates, so that they share no stroke: the window's length
PARAMETERS, LEAK = ("gain", "dead_zone"), "leak"


@short_repr
@dataclass(frozen=True)
class Trend:
    """Slope of one parameter over time.

    Attributes:
        direction: of the channel; empty of the leak.
        parameter: `gain`, the logarithm of the factor on it; `dead_zone`, what is added to it; `leak`, speed
            of the piston at standstill, negative where it sinks.
        per_hour: slope, 1/h of the gain, the command's unit/h of the dead zone, the displacement's unit/s/h
            of the leak.
        interval: 95 % interval of the slope.
        value: at the last estimate, on the line.
        limit_after_h: hours from the last estimate until a limit is reached: earliest within the interval of
            the slope, with the slope itself, and latest; infinite where it may stay.
    """

    direction: str
    parameter: str
    per_hour: float
    interval: tuple[float, float]
    value: float
    limit_after_h: tuple[float, float, float]

    @property
    def significant(self) -> bool:
        """Whether the interval of the slope excludes zero."""
        return self.interval[0] > 0 or self.interval[1] < 0


def trends(events: Sequence[Event], limits: Mapping[str, float]) -> tuple[Trend, ...]:
    """Return the trend of each parameter of each direction, by weighted least squares of a straight line.

    With estimates y(i) ± σ(i) at times t(i), weights 1/σ² and the scatter about the line, the slope has the
    standard error of a regression with n − 2 degrees of freedom. Estimates of gain and dead zone are at least
    eight strokes apart; those of the leak are of one standstill each.

    Args:
        events: change log, of one start of the adaptation.
        limits: parameter to its largest value either way: logarithm for the gain, the command's unit for the
            dead zone, the displacement's unit/s for the leak; one that is missing has no limit.

    Raises:
        InputError: an entry lacks a figure, or has a standard deviation that is not positive.
    """
    learned = [event for event in events if event.kind == LEARNED]
    found = []
    for direction in dict.fromkeys(event.direction for event in learned):
        apart = [event for event in learned if event.direction == direction][::-1][::STROKES_APART][::-1]
        if len(apart) >= FEWEST:
            found += [_trend(direction, parameter, apart, limits) for parameter in PARAMETERS]
    rested = [event for event in events if LEAK in event.figures]
    if len(rested) >= FEWEST:
        found.append(_trend("", LEAK, rested, limits))
    return tuple(found)


def _trend(direction: str, parameter: str, events: Sequence[Event], limits: Mapping[str, float]) -> Trend:
    for event in events:
        if parameter not in event.figures or not event.figures.get(f"{parameter}_deviation", 0.0) > 0:
            raise InputError(
                f"events: '{event.kind}' at {event.time_s:g} s: expected the figures {parameter}, and "
                f"{parameter}_deviation above 0"
            )
    hours = np.array([event.time_s for event in events]) / 3600
    values, deviations = (
        np.array([event.figures[name] for event in events]) for name in (parameter, f"{parameter}_deviation")
    )
    limit = limits.get(parameter, float("inf"))
    weights = 1 / deviations**2
    centred = hours - np.average(hours, weights=weights)
    spread = float(np.sum(weights * centred**2))
    slope = float(np.sum(weights * centred * values)) / spread
    mean = float(np.average(values, weights=weights))
    left = values - mean - slope * centred
    variance = max(1.0, float(np.sum(weights * left**2)) / (len(values) - 2)) / spread
    half_width = float(stdtrit(len(values) - 2, 0.975)) * float(np.sqrt(variance))
    value = mean + slope * float(centred[-1])
    ends = slope - half_width, slope + half_width
    rates = (ends[0], slope, ends[1])
    earliest = min(_hours_to_limit(value, rate, limit) for rate in rates)
    latest = max(_hours_to_limit(value, rate, limit) for rate in rates)
    if ends[0] <= 0 <= ends[1]:  # it may as well stay
        latest = float("inf")
    expected = _hours_to_limit(value, slope, limit)
    return Trend(direction, parameter, slope, ends, value, (earliest, expected, latest))


def _hours_to_limit(value: float, per_hour: float, limit: float) -> float:
    """Return the hours until a value reaches plus or minus a limit; infinite where it stays."""
    if per_hour == 0:
        return float("inf")
    return max(0.0, (np.copysign(limit, per_hour) - value) / per_hour)
