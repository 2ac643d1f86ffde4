"""Rivals: models fitted to the tests of one direction for comparison only; none of them is deployed."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hitchid._support.bounded import Count, Error, Number
from hitchid._support.records import short_repr
from hitchid.baselines.fitted import FittedBaseline
from hitchid.model.channel import Channel
from hitchid.model.estimates import Estimates
from hitchid.model.limits import TravelLimits


@short_repr
@dataclass(frozen=True)
class SearchSummary:
    """Summary of one global search of the parameters, run from several seeds.

    Attributes:
        name: name of the search.
        rmse: final root mean square error of each run, in the displacement's unit; None for a failed run.
        evaluations, failures: number of simulations of all tests in each run, and of those not finite.
        median_rmse: smallest RMSE so far of the run with the median result, for each iteration.
        median_values: parameters with that RMSE, for each iteration.
    """

    name: str
    rmse: tuple[Error | None, ...]
    evaluations: tuple[Count, ...]
    failures: tuple[Count, ...]
    median_rmse: tuple[Error | None, ...]
    median_values: tuple[tuple[Number, ...], ...]

    def scaled(self, factor: float) -> "SearchSummary":
        """Return the summary with a factor on the errors, for another unit of displacement."""
        return replace(self, rmse=_scaled(self.rmse, factor), median_rmse=_scaled(self.median_rmse, factor))


@short_repr
@dataclass(frozen=True)
class Rivals:
    """Models fitted to the same tests as a channel, for comparison.

    Attributes:
        baselines: name to fitted baseline.
        paper: model of Sun et al. 2025: a transfer function and, where it was trained, a compensator in
            closed loop on its own predictions in free run; None where not fitted, or where the channel
            itself is this model.
        paper_estimates: estimates of the parameters of its transfer function; None likewise.
        searches: summaries of the global searches that were compared; empty where none were.
        covariates: names of the covariates that the baselines use.
        notices: what could not be fitted, and why.
        trained: whether those are among them that are fitted on request only.
    """

    baselines: Mapping[str, FittedBaseline] = field(default_factory=dict)
    paper: Channel | None = None
    paper_estimates: Estimates | None = None
    searches: tuple[SearchSummary, ...] = ()
    covariates: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    trained: bool = False

    def with_limits(self, limits: TravelLimits | None) -> "Rivals":
        """Return the rivals with the paper's model limited to the limits of the plant."""
        return self if self.paper is None else replace(self, paper=replace(self.paper, limits=limits))


def _scaled(errors: tuple[float | None, ...], factor: float) -> tuple[float | None, ...]:
    return tuple(None if error is None else factor * error for error in errors)
