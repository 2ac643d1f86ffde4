"""Schema of a model folder: keys, types and bounds of all that `model.json` and `rivals.json` describe.

A folder may come from a stranger who put its digests right after an edit. What the schema accepts can be
simulated, shown and exported; all else is refused where it is read, by key and value.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from hitchid.errors import InputError, ModelFolderError
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT
from hitchid.logs.resampling import SHORTEST_STEP_S
from hitchid.logs.signal_map import DIMENSIONS, Strict, describe
from hitchid.logs.units import UNITS
from hitchid.model.bands import Bands
from hitchid.model.dynamics import MAX_MAGNITUDE
from hitchid.model.estimates import Characteristics, Estimates, Information, Uncertainty
from hitchid.model.limits import TravelLimits
from hitchid.model.provenance import TwoModes
from hitchid.model.rivals import SearchSummary
from hitchid.networks.error_compensator import FEATURES
from hitchid.structures import (
    DEAD_TIME,
    NONLINEARITY_PARAMETERS,
    ModelOption,
    Parameter,
    Scale,
    Structure,
    effect_parameters,
    scheduled_quantities,
    structure_named,
)
from hitchid.structures.nonlinearity import NEUTRAL, POWERS

SCHEMA = 13  # version of the layout of a model folder
LONGEST_STEP_S = 3600.0  # s; what is sampled more rarely is no drive: chosen
MAX_DELAY = 100_000  # samples of dead time, which a state holds; chosen: 10 s at 10 kHz
MAX_SAMPLES = 100_000  # that a compensator looks back or ahead; chosen: as many
SMALLEST = 1e-12  # of a parameter or a scale that is positive, in its unit; chosen
TINY = 1e-300  # of what is divided by
LARGEST_FACTOR = 1e30  # of a band: where held-out tests hardly differ from the ensemble it is beyond 1e10
# Settings of an identification may widen the bounds of a search. How far beyond the default ones a value is
# accepted: by this factor where its logarithm is searched, else by so many of their distances; chosen.
WIDENED, WIDENED_LINEAR = 1000.0, 5.0
ROUNDING = 1e-6  # by which a correlation may be beyond ±1

Direction = Annotated[str, Field(pattern=rf"^({'|'.join(DIRECTIONS)})$")]
Number = Annotated[float, Field(gt=-MAX_MAGNITUDE, lt=MAX_MAGNITUDE)]
Size = Annotated[float, Field(ge=0, lt=MAX_MAGNITUDE)]
Positive = Annotated[float, Field(ge=SMALLEST, lt=MAX_MAGNITUDE)]
StepTime = Annotated[float, Field(ge=SHORTEST_STEP_S, le=LONGEST_STEP_S)]
Samples = Annotated[int, Field(ge=1, le=MAX_SAMPLES)]


Item = TypeVar("Item")
Row = Annotated[tuple[Item, ...], Field(strict=False)]  # a list, in TOML, too


class Described(Strict):
    """Part of a description: its own keys only, no text for a number, and finite numbers."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class CurveScales(Described):
    """Scales of the curves; see `Scales`."""

    command: Positive
    centre: Number
    span: Positive


class Curves(Described):
    """Curves around a linear model; see `StaticNonlinearity`."""

    values: Row[float]
    scales: CurveScales


class CovariateScheduling(Described):
    """Effects of covariates on parameters; see `Scheduling`."""

    covariates: Row[str] = Field(min_length=1)
    quantities: Row[str]
    centre: Row[Number]
    spread: Row[Positive]
    effects: Row[Row[Row[float]]]


class PhysicalDescription(Described):
    """Physical model of one direction with its sign and its dead zone, within the bounds of its structure."""

    structure: str
    values: Row[float]
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
        described = {
            ModelOption.DEAD_TIME: self.dead_time_s != 0,
            ModelOption.VALVE_CURVE: self.shape is not None,
            ModelOption.COVARIATES: self.scheduling is not None,
        }
        for option, is_described in described.items():
            if is_described and option not in structure.options:
                raise ValueError(f"structure '{structure.name}' has no {option.value}, but one is described")
        _check_values("values", self.values, structure.parameters)
        _check_values("dead_time_s", [self.dead_time_s], [DEAD_TIME])
        if self.shape is not None:
            _check_values("shape.values", self.shape.values, NONLINEARITY_PARAMETERS)
        if self.scheduling is not None:
            self._check_scheduling(self.scheduling, structure)
        return self

    def _check_scheduling(self, scheduling: CovariateScheduling, structure: Structure) -> None:
        if self.shape is None:
            raise ValueError("scheduling: expected a shape, the curves that it changes, got none")
        quantities = scheduled_quantities(structure.require_linear())
        if scheduling.quantities != quantities:
            raise ValueError(
                f"scheduling.quantities: expected {_listed(quantities)}, got {_listed(scheduling.quantities)}"
            )
        count = len(scheduling.covariates)
        _check_shape("scheduling.covariates, each once", sorted(set(scheduling.covariates)), (count,))
        _check_shape("scheduling.centre", scheduling.centre, (count,))
        _check_shape("scheduling.spread", scheduling.spread, (count,))
        _check_shape("scheduling.effects", scheduling.effects, (len(quantities), count, len(POWERS)))
        effects = effect_parameters(structure.require_linear(), scheduling.covariates)
        _check_values("scheduling.effects", np.ravel(scheduling.effects).tolist(), effects)

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
        if features != FEATURES:
            raise ValueError(f"got {_listed(features)}, expected {_listed(FEATURES)}")
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
    drift: bool = False


class Sealed(Described):
    """What each description says of itself: layout, kind, digests of the files beside it and its own."""

    KIND: ClassVar[str]

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
        with _named("units"):
            _check_units(self.units, self.channels)
        for direction, channel in self.channels.items():
            with _named(f"channels.{direction}"):
                channel.check_delay(self.step_s)
        for direction, uncertainty in self.uncertainty.items():
            with _named(f"uncertainty.{direction}"):
                _check_names("direction", [direction], self.channels)
                _check_uncertainty(uncertainty, self.channels[direction])
        return self


class RivalsOfDirection(Described):
    """Rivals of one direction without their arrays; see `Rivals`."""

    baselines: tuple[str, ...]
    covariates: tuple[str, ...]
    paper: ChannelDescription | None
    paper_parameters: Estimates | None
    searches: tuple[SearchSummary, ...]
    notices: tuple[str, ...]
    trained: bool


class RivalsDescription(Sealed):
    """Content of `rivals.json`: the digest of the model, and the rivals of each direction."""

    KIND = "rivals of a hitchid model"

    model: str
    rivals: Mapping[Direction, RivalsOfDirection]


AnySealed = TypeVar("AnySealed", bound=Sealed)


def parse(kind: type[AnySealed], data: bytes, place: object) -> AnySealed:
    """Return a description from JSON.

    Raises:
        ModelFolderError: it is not of this schema; the message begins with `place`, and names key and value.
    """
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        raise ModelFolderError(f"{place}: {describe(error, kind)}") from error


def _check_values(where: str, values: Sequence[float], parameters: Sequence[Parameter]) -> None:
    """Raise ValueError unless each value is one that its parameter may have; see `_admissible`."""
    _check_shape(where, values, (len(parameters),))
    for parameter, value in zip(parameters, values, strict=True):
        lower, upper = _admissible(parameter)
        if not lower <= value <= upper and value != NEUTRAL.get(parameter.name):
            raise ValueError(f"{where}: {parameter.name}: got {value:g}, expected {lower:.4g} to {upper:.4g}")


def _admissible(parameter: Parameter) -> tuple[float, float]:
    """Return the lowest and the highest value of a parameter.

    Where the default bounds are absolute, these, widened; where they scale with the tests, any number. None
    is at or below zero where its logarithm is searched or the default bounds are above, but for a dead time
    of zero, which is none.
    """
    lower, upper = parameter.lower, parameter.upper
    positive = not parameter.linear or lower > 0
    if parameter.scale is not Scale.NONE or "{" in parameter.unit:
        ends = -MAX_MAGNITUDE, MAX_MAGNITUDE
    elif parameter.linear:
        ends = lower - WIDENED_LINEAR * (upper - lower), upper + WIDENED_LINEAR * (upper - lower)
    else:
        ends = lower / WIDENED, WIDENED * upper
    if parameter.name == DEAD_TIME.name or lower == 0:
        return 0.0, ends[1]
    return (max(ends[0], SMALLEST), ends[1]) if positive else ends


def _check_units(units: Mapping[str, str], directions: Collection[str]) -> None:
    roles = {DISPLACEMENT, *(COMMAND[direction] for direction in directions)}
    if missing := sorted(roles - units.keys()):
        raise ValueError(f"expected a unit of {_listed(missing)}, got units of {_listed(units)}")
    for role, unit in units.items():
        if unit not in UNITS:
            raise ValueError(f"{role}: got '{unit}', expected one of {', '.join(UNITS)}")
        dimension = UNITS[unit].dimension
        if dimension not in (accepted := DIMENSIONS.get(role, (dimension,))):
            raise ValueError(f"{role}: '{unit}' is of {dimension}, expected one of {', '.join(accepted)}")


def _check_uncertainty(uncertainty: Uncertainty, channel: ChannelDescription) -> None:
    parameters, estimates = channel.parameters, uncertainty.benchmark
    with _named("benchmark"):
        _check_estimates(estimates, [parameter.name for parameter in parameters])
    if uncertainty.information is not None:
        with _named("information"):
            _check_information(uncertainty.information, [each.name for each in estimates.parameters])
    if uncertainty.bands is not None:
        networks = 0 if channel.speed_compensator is None else channel.speed_compensator.members
        with _named("bands"):
            _check_bands(uncertainty.bands, parameters, networks)
    if uncertainty.characteristics is not None:
        with _named("characteristics"):
            _check_characteristics(uncertainty.characteristics, channel.covariates)


def _check_estimates(estimates: Estimates, names: Collection[str]) -> None:
    estimated = [estimate.name for estimate in estimates.parameters]
    _check_names("parameters", estimated, names)
    for estimate in estimates.parameters:
        ends = [end for end in (estimate.lower, estimate.value, *estimate.interval) if end is not None]
        if not estimate.lower < estimate.upper:
            bounds = f"{estimate.lower:g} and {estimate.upper:g}"
            raise ValueError(f"{estimate.name}: got bounds {bounds}, expected lower < upper")
        if not estimate.linear and min(ends) <= 0:
            raise ValueError(
                f"{estimate.name}: got {min(ends):g}, expected more than 0 on a logarithmic scale"
            )
        _check_range(f"{estimate.name}: error", [estimate.error or 0.0], 0.0, MAX_MAGNITUDE)
    _check_shape("correlation", estimates.correlation, (len(estimated), len(estimated)))
    _check_range("correlation", np.ravel(estimates.correlation).tolist(), -1 - ROUNDING, 1 + ROUNDING)


def _check_information(information: Information, estimated: Collection[str]) -> None:
    _check_names("names", information.names, estimated)
    count = len(information.names)
    _check_shape("slopes", information.slopes, (count,))
    for name in ("curvature", "score_covariance", "dead_zone_covariance"):
        _check_shape(name, getattr(information, name), (count, count))
    _check_shape("autocovariance", information.autocovariance[:1], (1,))
    _check_range("block_size", [information.block_size], 1.0, MAX_MAGNITUDE)
    _check_range("tests", [information.tests], 1.0, MAX_MAGNITUDE)
    _check_range("samples", [information.samples], 1.0, MAX_MAGNITUDE)


def _check_bands(bands: Bands, parameters: Sequence[Parameter], networks: int) -> None:
    for member in bands.ensemble:
        _check_values("ensemble.benchmark", member.benchmark, parameters)
        if member.network is not None:
            _check_range("ensemble.network", [member.network], 0.0, networks - 1.0)
        _check_range("ensemble.weight", [member.weight], -MAX_MAGNITUDE, MAX_MAGNITUDE)
    spread = bands.predictions
    levels, horizons = len(bands.levels), len(spread.horizons)
    _check_rising("levels", bands.levels)
    _check_range("levels", bands.levels, SMALLEST, 1 - SMALLEST)
    _check_shape("free_run", bands.free_run, (levels,))
    _check_rising("predictions.horizons", spread.horizons)
    _check_range("predictions.horizons", spread.horizons, 1.0, MAX_MAGNITUDE)
    _check_shape("predictions.movements", spread.movements, (horizons,))
    _check_shape("predictions.growths", spread.growths, (horizons,))
    _check_shape("predictions.multipliers", spread.multipliers, (horizons, levels))
    _check_range("predictions.movements", spread.movements, TINY, MAX_MAGNITUDE)
    for name, sizes in {
        "noise": [bands.noise, spread.noise],
        "free_run": bands.free_run,
        "predictions.exponent": [spread.exponent],
        "predictions.growths": spread.growths,
        "predictions.multipliers": np.ravel(spread.multipliers).tolist(),
    }.items():
        _check_range(name, sizes, 0.0, LARGEST_FACTOR)


def _check_characteristics(characteristics: Characteristics, covariates: Collection[str]) -> None:
    points, load = characteristics.speed_map, characteristics.load
    if load is not None:
        _check_names("load", [load], covariates)
    places = {(point.command, point.load) for point in points}
    commands, loads = {command for command, _ in places}, {load for _, load in places}
    if not points or not len(points) == len(places) == len(commands) * len(loads):
        raise ValueError("speed_map: expected one point for each command at each load, at least one")
    if (load is None) != (loads == {None}) or None in loads - {None}:
        raise ValueError(f"speed_map: expected {'no load' if load is None else 'a load'} in each point")


def _check_names(where: str, names: Sequence[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known or names.count(name) > 1:
            raise ValueError(f"{where}: got '{name}', expected each once, of {_listed(known)}")


def _check_shape(where: str, rows: object, shape: tuple[int, ...]) -> None:
    try:
        found = np.shape(rows)  # type: ignore[arg-type]
    except ValueError:  # rows of unequal lengths
        found = None
    if found != shape and not (0 in shape and found == (0,)):
        expected = " by ".join(map(str, shape))
        got = "rows of unequal lengths" if found is None else " by ".join(map(str, found))
        raise ValueError(f"{where}: got {got}, expected {expected}")


def _check_range(where: str, values: Iterable[float | int], lower: float, upper: float) -> None:
    for value in values:
        if not lower <= value <= upper:
            raise ValueError(f"{where}: got {value:g}, expected {lower:g} to {upper:g}")


def _check_rising(where: str, values: Collection[float | int]) -> None:
    if not values or list(values) != sorted(set(values)):
        raise ValueError(f"{where}: expected rising numbers, at least one")


def _listed(names: Collection[str]) -> str:
    return ", ".join(names) or "none"


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Put a name before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error
