"""Record of a load that differs from test to test: its scatter, and each test's own value."""

from dataclasses import dataclass

from hitchid._support.short_repr import short_repr
from hitchid.model.estimates import Interval

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
