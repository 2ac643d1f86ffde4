"""The trace of an identification, read from the content of `trace.json`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, TypeVar

from pydantic import Field, TypeAdapter, ValidationError

from hitchid._support.bounded import Count, Error, Number, Size
from hitchid._support.records import short_repr
from hitchid.errors import ModelFolderError
from hitchid.logs.signal_map import describe_settings
from hitchid.model.estimates import Estimate

MOST = Field(max_length=100)  # parameters, or structures that were compared: each is drawn; chosen
Item = TypeVar("Item")
# Of all that is wrong in it one is named: it may be long.
Series = Annotated[tuple[Item, ...], Field(fail_fast=True)]


@dataclass(frozen=True)
class TracedDeadZone:
    """A dead zone, its standard deviation, and the number and origin of its logs."""

    value: Size
    spread: Size | None
    count: Count
    origin: str


@dataclass(frozen=True)
class TracedEstimates:
    """Estimates of the parameters."""

    parameters: Annotated[tuple[Estimate, ...], MOST]


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
    fitness: Series[Error | None]
    searched: Series[str]
    values: Series[Series[Number]]

    def __post_init__(self) -> None:
        """Check the sizes and names against each other; raises ValueError."""
        estimated = {estimate.name for estimate in self.uncertainty.parameters}
        if not set(self.searched) <= estimated or len(set(self.searched)) < len(self.searched):
            raise ValueError(f"searched: expected each once, of {', '.join(estimated) or 'no parameters'}")
        sizes = {len(row) for row in self.values} | {len(self.searched)}
        if len(self.values) != len(self.fitness) or len(sizes) > 1:
            raise ValueError(
                f"values: got {len(self.values)} rows of {' or '.join(map(str, sorted(sizes)))}, expected "
                f"{len(self.fitness)} of {len(self.searched)}"
            )

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """Estimates of the searched parameters, after least squares."""
        by_name = {estimate.name: estimate for estimate in self.uncertainty.parameters}
        return tuple(by_name[name] for name in self.searched)


@dataclass(frozen=True)
class TracedTraining:
    """Losses of the error compensator over the epochs, and the selected epoch."""

    training_loss: Series[Error | None]
    validation_loss: Series[Error | None]
    best_epoch: Count


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
    rmse: Error | None
    held_out_rmse: Error | None
    chosen: bool
    held_out_rmse_per_test_gain: Error | None = None


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
    candidates: Annotated[tuple[TracedCandidate, ...], MOST]
    notices: Series[str]
    choice_held_out_rmse: Error | None = None

    def __post_init__(self) -> None:
        """Check that one of the candidates was chosen; raises ValueError."""
        if self.candidates and not any(candidate.chosen for candidate in self.candidates):
            raise ValueError("candidates: expected one that is chosen, got none")


def read_trace(content: Mapping[str, object]) -> dict[str, ChannelTraceFile]:
    """Return direction to trace; what a report does not show is passed over.

    Args:
        content: of `trace.json`, as `hitchid.model.load_trace` returns it.

    Raises:
        ModelFolderError: a key is missing, or a value is none that an identification writes.
    """
    try:
        return _ADAPTER.validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        raise ModelFolderError(f"trace.json: {describe_settings(error)}") from error


_ADAPTER = TypeAdapter(dict[str, ChannelTraceFile])
