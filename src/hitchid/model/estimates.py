"""Parameter estimates of one direction: values, intervals, verdicts."""

from dataclasses import dataclass, replace
from math import inf, log

from hitchid._support.bounded import Correlation, CountFromOne, FromOne, Size
from hitchid._support.records import short_repr
from hitchid.model.bands import Bands

# Record of the Fisher information of the identification tests, for correlated errors.


@short_repr
@dataclass(frozen=True)
class Information:
    """Fisher information of the identification tests, for the parameters that are not at a bound.

    Parameters are scaled to positions between the bounds of the search, 0 the lower and 1 the upper one.

    Attributes:
        names: names of these parameters.
        slopes: dθ/dposition of each parameter.
        curvature: H = Σ Jₜᵀ Jₜ.
        score_covariance: S = Σ gₜ gₜᵀ over tests; the covariance of the estimates is H⁻¹ S H⁻¹.
        dead_zone_covariance: added to it for the error of the dead zone; independent of the number of tests.
        autocovariance: autocovariance of the errors at multiples of the block size.
        block_size: samples between two lags of the autocovariance.
        per_test_gain: whether the fit had a gain factor for each test, which reduces the information.
        tests, samples: number of tests, and mean number of samples of a test.
    """

    names: tuple[str, ...]
    slopes: tuple[float, ...]
    curvature: tuple[tuple[float, ...], ...]
    score_covariance: tuple[tuple[float, ...], ...]
    dead_zone_covariance: tuple[tuple[float, ...], ...]
    autocovariance: tuple[float, ...]
    block_size: CountFromOne
    per_test_gain: bool
    tests: CountFromOne
    samples: FromOne


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
    error: Size | None
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
    correlation: tuple[tuple[Correlation, ...], ...]
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


# Operating characteristics of one direction: speed map, dead zone, opening, delay, response time.

# Error up to which a speed is determined, as a share of it and of the fastest speed of the map; chosen.
SPEED_TOLERANCE, FASTEST_SPEED_TOLERANCE = 0.25, 0.05
TIME_RESOLUTION_SAMPLES = 2  # samples: an interval of a delay up to this width is determined; chosen


@short_repr
@dataclass(frozen=True)
class SpeedPoint:
    """Steady speed at one level of the command, at mid stroke.

    Attributes:
        command: size of the command as logged.
        load: the covariate before motion; None where the model has none.
        speed: positive in the direction of the command, in the displacement's unit per s.
        interval: 95 % interval; None for an end that the tests do not determine.
        determined: whether both ends lie within a quarter of the speed, or within a twentieth of the
            fastest one of the map.
    """

    command: float
    load: float | None
    speed: float
    interval: Interval
    determined: bool

    @classmethod
    def of(
        cls, command: float, load: float | None, speed: float, interval: Interval, fastest: float
    ) -> "SpeedPoint":
        """Create a point, determined or not by its interval; `fastest` is the fastest speed of the map."""
        lower, upper = interval
        tolerance = max(SPEED_TOLERANCE * speed, FASTEST_SPEED_TOLERANCE * fastest)
        determined = (
            lower is not None and upper is not None and max(speed - lower, upper - speed) <= tolerance
        )
        return cls(command, load, speed, interval, determined)

    def scaled(self, factor: float) -> "SpeedPoint":
        """Return the point with a factor on the gain."""
        return replace(self, speed=factor * self.speed, interval=_scale_interval(self.interval, factor))


@short_repr
@dataclass(frozen=True)
class MeasuredSpeed:
    """Mean speed of an identification test around mid stroke at a constant command.

    Attributes:
        command, load, speed: as in `SpeedPoint`, measured.
    """

    command: float
    load: float | None
    speed: float


@short_repr
@dataclass(frozen=True)
class Characteristics:
    """Operating characteristics of one direction, derived from the fitted model.

    Attributes:
        command_unit, speed_unit: units of all commands and speeds.
        load: name of the covariate; None where the model has none.
        dead_zone: dead zone of the command, from ramps or tests, or as given.
        opening: command at which flow begins; None where the model has no valve curve.
        level: size of the command step for delay and response time.
        delay: time from a command step at rest until the speed reaches 5 % of its final value, s; None
            where the model has neither dead time nor lag.
        response_time: the same until 63.2 %, delay included, s; None likewise.
        speed_map: steady speed at mid stroke at each level, for each load.
        measured: speeds measured in identification tests with a long enough constant command.
    """

    command_unit: str
    speed_unit: str
    load: str | None
    dead_zone: Quantity
    opening: Quantity | None
    level: float
    delay: Quantity | None
    response_time: Quantity | None
    speed_map: tuple[SpeedPoint, ...]
    measured: tuple[MeasuredSpeed, ...]

    @property
    def quantities(self) -> dict[str, tuple[Quantity, str]]:
        """Dead zone, command at which flow begins, delay and response time, as far as known, with units."""
        quantities = {
            "dead_zone": (self.dead_zone, self.command_unit),
            "flow_begins": (self.opening, self.command_unit),
            "delay": (self.delay, "s"),
            "response_time": (self.response_time, "s"),
        }
        return {name: (quantity, unit) for name, (quantity, unit) in quantities.items() if quantity}

    def scaled(self, factor: float) -> "Characteristics":
        """Return the characteristics with a factor on the gain; measured speeds are not changed."""
        return replace(self, speed_map=tuple(point.scaled(factor) for point in self.speed_map))


# Record of a load that differs from test to test: its scatter, and each test's own value.

STANDSTILL = -1.0  # speed of a test above the model's, relative, at which the piston stands
MAX_SHRINKAGE = 0.3  # of a scatter that is determined; Savic & Karlsson 2009 call 0.2 to 0.3 high


@short_repr
@dataclass(frozen=True)
class LoadOfTest:
    """How much faster than the model one test runs.

    Attributes:
        test: its name.
        speed: b, relative: 0.04 runs 4 % fast.
        interval: 95 % interval; −1 at least, at which the piston stands.
    """

    test: str
    speed: float
    interval: tuple[float, float]

    @property
    def determined(self) -> bool:
        """Whether the interval excludes a piston that stands, which no load of a test that moves explains."""
        return self.interval[0] > STANDSTILL


@short_repr
@dataclass(frozen=True)
class LoadScatter:
    """Scatter of the speed between tests due to a load that nobody measures, and each test's own speed.

    Attributes:
        scatter: ω, standard deviation of the speed between tests, relative.
        interval: 95 % interval of ω; the upper end is None where the tests do not determine it.
        shrinkage: 1 − sd(b̂)/ω, b̂ the values of the tests; 1 where ω is 0.
        tests: each test's own value, in the order of the tests.
    """

    scatter: float
    interval: Interval
    shrinkage: float
    tests: tuple[LoadOfTest, ...]

    @property
    def determined(self) -> bool:
        """Whether the interval excludes 0 and is closed, and the shrinkage is at most 30 %."""
        lower, upper = self.interval
        return bool(lower) and upper is not None and self.shrinkage <= MAX_SHRINKAGE

    @property
    def sentence(self) -> str:
        """The scatter with its interval, in percent."""
        lower, upper = self.interval
        ends = f"{100 * (lower or 0.0):.2g} to " + ("∞" if upper is None else f"{100 * upper:.2g}")
        caveat = "" if self.determined else ", not determined"
        return f"speed differs between tests by ± {100 * self.scatter:.2g} % (95 %: {ends} %{caveat})"


# Record of the uncertainty of one channel: parameters, bands, operating characteristics.


@short_repr
@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of one channel.

    Attributes:
        benchmark: estimates of the benchmark's parameters.
        bands: bands around the predictions; None where there were too few tests.
        information: Fisher information of the tests, for the design of the next one.
        characteristics: speed map, dead zone, delay and response time; None where the structure has no steady
            speed, or where they could not be computed.
        load_scatter: scatter of the speed between tests; None where it could not be computed.
    """

    benchmark: Estimates
    bands: Bands | None = None
    information: Information | None = None
    characteristics: Characteristics | None = None
    load_scatter: LoadScatter | None = None
