"""The trace of an identification, read from the content of `trace.json`."""

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import TypeAdapter, ValidationError

from hitchid._support.records import short_repr
from hitchid.model.estimates import Estimate


@dataclass(frozen=True)
class TracedDeadZone:
    """A dead zone, its standard deviation, and the number and origin of its logs."""

    value: float
    spread: float | None
    count: int
    origin: str


@dataclass(frozen=True)
class TracedEstimates:
    """Estimates of the parameters."""

    parameters: tuple[Estimate, ...]


@dataclass(frozen=True)
class TracedSearch:
    """The search for the parameters.

    Attributes:
        uncertainty: estimates after least squares.
        fitness: best RMSE so far by iteration, in the model's unit; None while none was finite.
        searched: names of the parameters that were searched; a model of a larger form has more.
        values: the parameters of that RMSE, one row per iteration.
    """

    uncertainty: TracedEstimates
    fitness: tuple[float | None, ...]
    searched: tuple[str, ...]
    values: tuple[tuple[float, ...], ...]

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """Estimates of the searched parameters, after least squares."""
        by_name = {estimate.name: estimate for estimate in self.uncertainty.parameters}
        return tuple(by_name[name] for name in self.searched)


@dataclass(frozen=True)
class TracedTraining:
    """Losses of the error compensator over the epochs, and the selected epoch."""

    training_loss: tuple[float | None, ...]
    validation_loss: tuple[float | None, ...]
    best_epoch: int


@dataclass(frozen=True)
class TracedCandidate:
    """A compared model specification.

    Attributes:
        name: of the specification.
        rmse, held_out_rmse: in free run on all tests and on held-out levels.
        chosen: whether it was chosen.
        held_out_rmse_per_test_gain: on held-out levels with a gain fitted to each test.
    """

    name: str
    rmse: float | None
    held_out_rmse: float | None
    chosen: bool
    held_out_rmse_per_test_gain: float | None = None


@short_repr
@dataclass(frozen=True)
class ChannelTraceFile:
    """Trace of the identification of one direction.

    Attributes:
        dead_zone: of the command.
        phase1: search for the parameters.
        phase2: training of the compensator; None where there was none.
        candidates: model specifications that were compared.
        notices: of the identification.
        choice_held_out_rmse: RMSE on levels that neither fitted nor chose the specification; None where
            nothing was chosen.
    """

    dead_zone: TracedDeadZone
    phase1: TracedSearch
    phase2: TracedTraining | None
    candidates: tuple[TracedCandidate, ...]
    notices: tuple[str, ...]
    choice_held_out_rmse: float | None = None


def read_trace(content: Mapping[str, object]) -> dict[str, ChannelTraceFile]:
    """Return direction to trace; directions in the format of an older version are left out.

    Args:
        content: of `trace.json`, as `hitchid.model.load_trace` returns it.
    """
    traces = {}
    for direction, trace in content.items():
        try:
            traces[direction] = _ADAPTER.validate_python(trace)
        except ValidationError:
            continue
    return traces


_ADAPTER = TypeAdapter(ChannelTraceFile)
