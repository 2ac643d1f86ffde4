"""Parameter estimates of one direction: values, intervals, verdicts."""

from dataclasses import dataclass, replace
from math import inf, log

from hitchid._support.short_repr import short_repr

Interval = tuple[float | None, float | None]
NOT_ASSESSED = "none"  # method of an estimate for which no interval was computed
MAX_INTERVAL_RATIO = 3.0  # largest upper/lower end of the interval of a determined quantity; chosen


@short_repr
@dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter and its uncertainty.

    Attributes:
        name, symbol, unit: as in the structure, in the log's units.
        value: the estimate.
        error: standard error for correlated residuals within a test; None for a parameter at a bound.
        interval: 95 % interval; None for an end that the tests do not determine.
        method: method of the interval, `Gauss-Newton` or `profile`; `none` where it was not computed.
        bootstrap: 95 % interval by resampling of tests; None for a parameter at a bound.
        lower, upper: bounds of the search.
        linear: whether the search scale between the bounds is linear; otherwise logarithmic.
        determined: whether the interval is closed and narrow.
        verdict: sentence on how well the parameter is determined.
        sensitivity: mean relative change of the RMSE for ±1 % of the value (Sun et al. 2025, sec. 3.1.1).
        profile: pairs of fixed value and RMSE with all other parameters fitted; empty where no profile
            was computed.
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
        """Width of the interval: log of its ends' ratio; if linear, four times its share of the bounds."""
        lower, upper = self.interval
        if lower is None or upper is None:
            return inf
        return 4 * (upper - lower) / (self.upper - self.lower) if self.linear else log(upper / lower)

    def scaled(self, factor: float) -> "Estimate":
        """Return the estimate multiplied by a factor."""
        return replace(
            self,
            value=factor * self.value,
            error=None if self.error is None else factor * self.error,
            interval=_scale_interval(self.interval, factor),
            bootstrap=self.bootstrap and _scale_interval(self.bootstrap, factor),
            profile=tuple((factor * value, fitness) for value, fitness in self.profile),
        )


@short_repr
@dataclass(frozen=True)
class Quantity:
    """Quantity derived from the parameters: a lag, a bandwidth, a coefficient of the paper.

    Attributes:
        name, unit: name, and unit in the log's units.
        value: value at the estimate.
        interval: 95 % interval propagated from the parameters; None for an end that is not determined.
        determined: whether the interval is closed and narrow.
    """

    name: str
    unit: str
    value: float
    interval: Interval
    determined: bool

    def scaled(self, factor: float) -> "Quantity":
        """Return the quantity multiplied by a factor."""
        return replace(self, value=factor * self.value, interval=_scale_interval(self.interval, factor))


@short_repr
@dataclass(frozen=True)
class Estimates:
    """Parameter estimates of one direction from the identification tests.

    Attributes:
        parameters: estimate of each parameter.
        derived: quantities derived from the parameters.
        correlation: correlation matrix of the estimates, in their order; zero for one at a bound.
        tests: number of tests.
        rows: number of blocks taken as independent: tests, or sections of them where they are few.
    """

    parameters: tuple[Estimate, ...]
    derived: tuple[Quantity, ...]
    correlation: tuple[tuple[float, ...], ...]
    tests: int
    rows: int

    def scaled(self, name: str, factor: float) -> "Estimates":
        """Return the estimates with one parameter multiplied by a factor, without derived quantities."""
        parameters = [
            estimate.scaled(factor) if estimate.name == name else estimate for estimate in self.parameters
        ]
        return replace(self, parameters=tuple(parameters), derived=())


def make_quantity(name: str, unit: str, value: float, interval: Interval, resolution: float) -> Quantity:
    """Return a quantity; determined if its interval is closed, and within a factor of three or narrow.

    Args:
        name, unit, value, interval: see `Quantity`.
        resolution: width up to which an interval is narrow at any value, in the unit.
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
