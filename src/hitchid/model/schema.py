"""Schema of a model folder: keys, types and bounds of all that `model.json` and `rivals.json` describe.

A folder may come from a stranger who put its digests right after an edit. What the schema accepts can be
simulated, shown and exported; all else is refused where it is read, by key and value.
"""

from collections.abc import Collection, Mapping
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from hitchid._support.bounded import MAX_MAGNITUDE, Number, Positive, Size
from hitchid.errors import InputError, ModelFolderError
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.logs.resampling import SHORTEST_STEP_S
from hitchid.logs.signal_map import DIMENSIONS, StrictSettings, describe_settings
from hitchid.logs.units import UNITS
from hitchid.model.estimates import Estimates, Uncertainty
from hitchid.model.limits import TravelLimits
from hitchid.model.provenance import TwoModes
from hitchid.model.rivals import SearchSummary
from hitchid.model.schema_checks import (
    check_bands,
    check_characteristics,
    check_estimates,
    check_information,
    check_names,
    check_shape,
    check_values,
    listed,
    named,
)
from hitchid.networks.error_compensator import COMPENSATOR_FEATURES
from hitchid.structures import (
    DEAD_TIME,
    NONLINEARITY_PARAMETERS,
    ModelOption,
    Parameter,
    Structure,
    effect_parameters,
    scheduled_quantities,
    structure_named,
)
from hitchid.structures.nonlinearity import POWERS

SCHEMA = 14  # version of the layout of a model folder
LONGEST_STEP_S = 3600.0  # s; what is sampled more rarely is no drive: chosen
MAX_DELAY = 100_000  # samples of dead time, which a state holds; chosen: 10 s at 10 kHz
MAX_SAMPLES = 100_000  # that a compensator looks back or ahead; chosen: as many

Direction = Annotated[str, Field(pattern=rf"^({'|'.join(DIRECTIONS)})$")]
StepTime = Annotated[float, Field(ge=SHORTEST_STEP_S, le=LONGEST_STEP_S)]
Samples = Annotated[int, Field(ge=1, le=MAX_SAMPLES)]


Item = TypeVar("Item")
DescribedRow = Annotated[tuple[Item, ...], Field(strict=False)]  # a list, in TOML, too


class Described(StrictSettings):
    """Part of a description: its own keys only, no text for a number, and finite numbers."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class CurveScales(Described):
    """Scales of the curves; see `Scales`."""

    command: Positive
    centre: Number
    span: Positive


class Curves(Described):
    """Curves around a linear model; see `StaticNonlinearity`."""

    values: DescribedRow[float]
    scales: CurveScales


class CovariateScheduling(Described):
    """Effects of covariates on parameters; see `Scheduling`."""

    covariates: DescribedRow[str] = Field(min_length=1)
    quantities: DescribedRow[str]
    centre: DescribedRow[Number]
    spread: DescribedRow[Positive]
    effects: DescribedRow[DescribedRow[DescribedRow[float]]]


class PhysicalDescription(Described):
    """Physical model of one direction with its sign and its dead zone, within the bounds of its structure."""

    structure: str
    values: DescribedRow[float]
    dead_time_s: float
    shape: Curves | None = None
    scheduling: CovariateScheduling | None = None
    direction: int
    dead_zone: Size

    @field_validator("direction")
    @classmethod
    def _sign(cls, direction: int) -> int:
        if direction not in (1, -1):
            raise ValueError("expected 1 or -1")
        return direction

    @model_validator(mode="after")
    def _of_its_structure(self) -> "PhysicalDescription":
        try:
            structure = structure_named(self.structure)
        except InputError as error:
            raise ValueError(str(error)) from error
        # A part that the structure has not would be simulated all the same.
        described = {
            ModelOption.DEAD_TIME: self.dead_time_s != 0,
            ModelOption.VALVE_CURVE: self.shape is not None,
            ModelOption.COVARIATES: self.scheduling is not None,
        }
        for option, is_described in described.items():
            if is_described and option not in structure.options:
                raise ValueError(f"structure '{structure.name}' has no {option.value}, but one is described")
        check_values("values", self.values, structure.parameters)
        check_values("dead_time_s", [self.dead_time_s], [DEAD_TIME])
        if self.shape is not None:
            check_values("shape.values", self.shape.values, NONLINEARITY_PARAMETERS)
        if self.scheduling is not None:
            self._check_scheduling(self.scheduling, structure)
        return self

    def _check_scheduling(self, scheduling: CovariateScheduling, structure: Structure) -> None:
        if self.shape is None:
            raise ValueError("scheduling: expected a shape, the curves that it changes, got none")
        quantities = scheduled_quantities(structure.require_linear())
        if scheduling.quantities != quantities:
            raise ValueError(
                f"scheduling.quantities: expected {listed(quantities)}, got {listed(scheduling.quantities)}"
            )
        count = len(scheduling.covariates)
        check_shape("scheduling.covariates, each once", sorted(set(scheduling.covariates)), (count,))
        check_shape("scheduling.centre", scheduling.centre, (count,))
        check_shape("scheduling.spread", scheduling.spread, (count,))
        check_shape("scheduling.effects", scheduling.effects, (len(quantities), count, len(POWERS)))
        effects = effect_parameters(structure.require_linear(), scheduling.covariates)
        check_values("scheduling.effects", np.ravel(scheduling.effects).tolist(), effects)

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the covariates that its parameters vary with."""
        return () if self.scheduling is None else self.scheduling.covariates

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its parameters, in the order of `PhysicalModel.parameters`."""
        structure = structure_named(self.structure)
        curves = () if self.shape is None else NONLINEARITY_PARAMETERS
        effects = effect_parameters(structure.require_linear(), self.covariates) if self.covariates else ()
        return (*structure.parameters, DEAD_TIME, *curves, *effects)

    def check_delay(self, step_s: float) -> None:
        """Raise ValueError where the dead time has too many samples."""
        if self.dead_time_s > MAX_DELAY * step_s:
            raise ValueError(
                f"dead_time_s: got {self.dead_time_s:g} s, {self.dead_time_s / step_s:.4g} samples of "
                f"{step_s:g} s; expected at most {MAX_DELAY} samples"
            )


class CompensatorSizes(Described):
    """Sizes of an error compensator; see `Compensator`."""

    window: Samples
    max_horizon: Samples
    hidden: Samples
    features: tuple[str, ...]

    @field_validator("features")
    @classmethod
    def _of_this_version(cls, features: tuple[str, ...]) -> tuple[str, ...]:
        if features != COMPENSATOR_FEATURES:
            raise ValueError(f"got {listed(features)}, expected {listed(COMPENSATOR_FEATURES)}")
        return features


class SpeedCompensatorSizes(Described):
    """Sizes of a compensator for free run; see `SpeedCompensator`."""

    members: Samples
    units: Samples


class ChannelDescription(PhysicalDescription):
    """A channel without its trained arrays; see `Channel`."""

    end_stop: Number | None
    limits: TravelLimits | None
    compensator: CompensatorSizes | None
    speed_compensator: SpeedCompensatorSizes | None

    @field_validator("limits")
    @classmethod
    def _in_order(cls, limits: TravelLimits | None) -> TravelLimits | None:
        if limits is not None and not -MAX_MAGNITUDE < limits.lower < limits.upper < MAX_MAGNITUDE:
            raise ValueError(f"got {limits.lower:g} to {limits.upper:g}, expected lower < upper within ±1e9")
        return limits


class Split(Described):
    """Names of the tests of each direction; see `Provenance`."""

    identification: Mapping[Direction, tuple[str, ...]]
    validation: Mapping[Direction, tuple[str, ...]]
    held_out: Mapping[Direction, tuple[str, ...]]


class KeptSettings(Described):
    """Settings of an identification, as its configuration describes them."""

    structure: Mapping[Direction, Mapping[str, Any]] = Field(default_factory=dict)
    search: Mapping[str, Any] = Field(default_factory=dict)
    training: Mapping[str, Any] = Field(default_factory=dict)
    dead_zones: Mapping[Direction, Size] = Field(default_factory=dict)
    drift: bool | None = None


class Sealed(Described):
    """What each description says of itself: layout, kind, digests of the files beside it and its own."""

    KIND: ClassVar[str]

    # Not `schema`, which pydantic's models have for another purpose.
    layout: int = Field(alias="schema")
    kind: str
    files: Mapping[str, str]
    digest: str


class ModelDescription(Sealed):
    """Content of `model.json`; see `Hitch` and `Provenance`."""

    KIND = "hitchid model"

    step_s: StepTime
    channels: Mapping[Direction, ChannelDescription] = Field(min_length=1)
    units: Mapping[str, str]
    drift: Number
    two_modes: TwoModes | None
    uncertainty: Mapping[Direction, Uncertainty]
    split: Split
    seen: frozenset[str]
    cut_at: Mapping[Direction, Size]
    seed: Annotated[int, Field(ge=0, lt=2**64)]
    settings: KeptSettings
    versions: Mapping[str, str]
    set_by_hand: Mapping[Direction, Mapping[str, Number]]
    adapted: Mapping[Direction, Mapping[str, Number]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _fits_together(self) -> "ModelDescription":
        with named("units"):
            _check_units(self.units, self.channels)
        for direction, channel in self.channels.items():
            with named(f"channels.{direction}"):
                channel.check_delay(self.step_s)
        for direction, uncertainty in self.uncertainty.items():
            with named(f"uncertainty.{direction}"):
                check_names("direction", [direction], self.channels)
                _check_uncertainty(uncertainty, self.channels[direction])
        return self


class RivalsOfDirection(Described):
    """Rivals of one direction without their arrays; see `Rivals`."""

    baselines: tuple[str, ...]
    covariates: tuple[str, ...]
    paper: ChannelDescription | None
    paper_parameters: Estimates | None
    searches: tuple[SearchSummary, ...] = Field(max_length=100)  # each is drawn; chosen
    notices: tuple[str, ...]
    trained: bool

    @model_validator(mode="after")
    def _fits_together(self) -> "RivalsOfDirection":
        for search in self.searches:
            runs, iterations = max(len(search.rmse), 1), len(search.median_rmse)
            for name in ("rmse", "evaluations", "failures"):
                check_shape(f"searches: {search.name}: {name}", getattr(search, name), (runs,))
            parameters = len(search.median_values[0]) if search.median_values else 0
            check_shape(
                f"searches: {search.name}: median_values", search.median_values, (iterations, parameters)
            )
        if self.paper is not None and self.paper.covariates:
            raise ValueError(f"paper: got covariates {listed(self.paper.covariates)}, expected none")
        if self.paper is not None and self.paper_parameters is not None:
            with named("paper_parameters"):
                check_estimates(self.paper_parameters, [each.name for each in self.paper.parameters])
        return self


class RivalsDescription(Sealed):
    """Content of `rivals.json`: the digest of the model, and the rivals of each direction."""

    KIND = "rivals of a hitchid model"

    model: str
    rivals: Mapping[Direction, RivalsOfDirection]

    def check_model(self, model: ModelDescription) -> None:
        """Raise ValueError unless these may be the rivals of a model."""
        check_names("rivals", list(self.rivals), model.channels)
        for direction, of_direction in self.rivals.items():
            if of_direction.paper is not None:
                with named(f"rivals.{direction}.paper"):
                    of_direction.paper.check_delay(model.step_s)


AnySealed = TypeVar("AnySealed", bound=Sealed)


def parse(kind: type[AnySealed], data: bytes, place: object) -> AnySealed:
    """Return a description from JSON.

    Raises:
        ModelFolderError: it is not of this schema; the message begins with `place`, and names key and value.
    """
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        raise ModelFolderError(f"{place}: {describe_settings(error, kind)}") from error


def _check_units(units: Mapping[str, str], directions: Collection[str]) -> None:
    roles = {DISPLACEMENT, *(COMMAND[direction] for direction in directions)}
    if missing := sorted(roles - units.keys()):
        raise ValueError(f"expected a unit of {listed(missing)}, got units of {listed(units)}")
    for role, unit in units.items():
        if unit not in UNITS:
            raise ValueError(f"{role}: got '{unit}', expected one of {', '.join(UNITS)}")
        dimension = UNITS[unit].dimension
        if dimension not in (accepted := DIMENSIONS.get(role, (dimension,))):
            raise ValueError(f"{role}: '{unit}' is of {dimension}, expected one of {', '.join(accepted)}")


def _check_uncertainty(uncertainty: Uncertainty, channel: ChannelDescription) -> None:
    parameters, estimates = channel.parameters, uncertainty.benchmark
    with named("benchmark"):
        check_estimates(estimates, [parameter.name for parameter in parameters])
    if uncertainty.information is not None:
        with named("information"):
            check_information(uncertainty.information, [estimate.name for estimate in estimates.parameters])
    if uncertainty.bands is not None:
        networks = 0 if channel.speed_compensator is None else channel.speed_compensator.members
        with named("bands"):
            check_bands(uncertainty.bands, parameters, networks)
    if uncertainty.characteristics is not None:
        with named("characteristics"):
            check_characteristics(uncertainty.characteristics, channel.covariates)
