"""What was fitted to the tests of one direction for comparison only; nothing of it is deployed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hitchid.baselines.fitted import FittedBaseline
from hitchid.model.channel import Channel
from hitchid.model.estimates import Estimates
from hitchid.model.limits import TravelLimits


@dataclass(frozen=True)
class SearchSummary:
    """How one global search of the parameters went from several seeds.

    Attributes:
        name: name of the search.
        rmse: final root mean square error of each run, in the displacement's unit; None for a failed run.
        evaluations, failures: of each run, simulations of all tests, and how many were not finite.
        median_rmse: best error so far of the run with the median result, an entry an iteration.
        median_values: the parameters that gave it, an entry an iteration.
    """

    name: str
    rmse: tuple[float | None, ...]
    evaluations: tuple[int, ...]
    failures: tuple[int, ...]
    median_rmse: tuple[float | None, ...]
    median_values: tuple[tuple[float, ...], ...]

    def scaled(self, factor: float) -> "SearchSummary":
        """Return the summary with the errors in another unit of displacement."""
        return replace(self, rmse=_scaled(self.rmse, factor), median_rmse=_scaled(self.median_rmse, factor))


@dataclass(frozen=True)
class Comparison:
    """What was fitted to the same tests as a channel, for comparison.

    Attributes:
        baselines: name to fitted baseline.
        paper: the method of Sun et al. 2025: a transfer function, and a compensator that in free run takes
            its own predictions as measurements; None where not fitted, or where the channel is that.
        paper_estimates: estimates of the parameters of its transfer function; None likewise.
        searches: summaries of the global searches that were compared; empty where none were.
    """

    baselines: Mapping[str, FittedBaseline] = field(default_factory=dict)
    paper: Channel | None = None
    paper_estimates: Estimates | None = None
    searches: tuple[SearchSummary, ...] = ()

    def with_limits(self, limits: TravelLimits | None) -> "Comparison":
        """Return the comparison with the paper's method held within the limits of the plant."""
        return self if self.paper is None else replace(self, paper=replace(self.paper, limits=limits))


def _scaled(errors: tuple[float | None, ...], factor: float) -> tuple[float | None, ...]:
    return tuple(None if error is None else factor * error for error in errors)
