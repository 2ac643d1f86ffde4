"""What is known of the parameters of one direction: estimates, intervals, verdicts; one frozen record."""

from dataclasses import dataclass, replace
from math import inf, log

import numpy as np

Interval = tuple[float | None, float | None]
MAX_INTERVAL_RATIO = 3.0


@dataclass(frozen=True)
class Estimate:
    """One parameter as found, and how well.

    Attributes:
        name, symbol, unit: as in the structure, the unit in the log's units.
        value: the estimate.
        error: standard error, residuals of one test taken as correlated; None where it is at a bound.
        interval: 95 % interval; None for an end that the tests do not give.
        method: how the interval was found, `Gauss-Newton` or `profile`.
        bootstrap: 95 % interval from tests drawn anew; None where the parameter is at a bound.
        lower, upper: bounds of the search.
        linear: whether the search runs between the bounds as they are, not their logarithms.
        determined: whether the interval is closed and narrow.
        verdict: the finding in words.
        sensitivity: mean relative change of the RMSE for ±1 % of it (Sun et al. 2025, sec. 3.1.1).
        profile: RMSE with this parameter held and all others fitted, as pairs of value and RMSE; empty
            where the interval did not ask for it.
    """

    name: str
    symbol: str
    unit: str
    value: float
    error: float | None
    interval: Interval
    method: str
    bootstrap: Interval | None
    lower: float
    upper: float
    linear: bool
    determined: bool
    verdict: str
    sensitivity: float
    profile: tuple[tuple[float, float], ...] = ()

    @property
    def log_interval_width(self) -> float:
        """How wide the interval is: log of its ends' ratio, around zero four times its share of the room."""
        lower, upper = self.interval
        if lower is None or upper is None:
            return inf
        return 4 * (upper - lower) / (self.upper - self.lower) if self.linear else log(upper / lower)

    def scaled(self, factor: float) -> "Estimate":
        """Return it multiplied by a factor."""
        return replace(
            self,
            value=factor * self.value,
            error=None if self.error is None else factor * self.error,
            interval=_scale_interval(self.interval, factor),
            bootstrap=self.bootstrap and _scale_interval(self.bootstrap, factor),
            profile=tuple((factor * value, fitness) for value, fitness in self.profile),
        )

    def value_at(self, position: np.ndarray) -> np.ndarray:
        """Return the values at positions between the bounds, 0 the lower and 1 the upper one."""
        if self.linear:
            return self.lower + position * (self.upper - self.lower)
        return self.lower * (self.upper / self.lower) ** position


@dataclass(frozen=True)
class Quantity:
    """What follows from the parameters: a lag, a bandwidth, the coefficients of the paper.

    Attributes:
        name, unit: in the log's units.
        value: at the estimate.
        interval: 95 % interval, carried over from the parameters; None for an end that is not given.
        determined: whether the interval is closed and narrow.
    """

    name: str
    unit: str
    value: float
    interval: Interval
    determined: bool

    def scaled(self, factor: float) -> "Quantity":
        """Return it in another scale."""
        return replace(self, value=factor * self.value, interval=_scale_interval(self.interval, factor))


@dataclass(frozen=True)
class Estimates:
    """What the identification tests say of the parameters of one direction.

    Attributes:
        parameters: each of them.
        derived: what follows from them.
        correlation: of the estimates, in their order; zero for one at a bound.
        tests: how many there were.
        rows: what was taken as independent: tests, or where they are few their stretches.
    """

    parameters: tuple[Estimate, ...]
    derived: tuple[Quantity, ...]
    correlation: tuple[tuple[float, ...], ...]
    tests: int
    rows: int

    def scaled(self, name: str, factor: float) -> "Estimates":
        """Return them with one parameter multiplied by a factor, without the derived quantities."""
        parameters = [each.scaled(factor) if each.name == name else each for each in self.parameters]
        return replace(self, parameters=tuple(parameters), derived=())


def make_quantity(name: str, unit: str, value: float, interval: Interval, resolution: float) -> Quantity:
    """Return a quantity, determined where its interval is closed and within a factor of three, or fine.

    Args:
        name, unit, value, interval: see `Quantity`.
        resolution: a width that is fine whatever the value, in the unit.
    """
    lower, upper = interval
    narrow = (
        lower is not None
        and upper is not None
        and (upper <= MAX_INTERVAL_RATIO * lower or upper - lower <= resolution)
    )
    return Quantity(name, unit, value, interval, narrow)


def _scale_interval(interval: Interval, factor: float) -> Interval:
    lower, upper = interval
    return None if lower is None else factor * lower, None if upper is None else factor * upper
