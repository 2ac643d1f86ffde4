"""Model of the whole plant: one channel for each direction, switched by the commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import jax
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid.data.record import COMMAND, DIRECTIONS, Record
from hitchid.data.segmentation import CommandThreshold
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model import conversion, extrapolation
from hitchid.model.bands import Band, Bands
from hitchid.model.channel import Channel
from hitchid.model.comparison import Comparison
from hitchid.model.dynamics import MAX_MAGNITUDE, HitchDynamics
from hitchid.model.ensemble import hitch_half_width
from hitchid.model.free_run import FreeRun, free_run, multi_step_predictions
from hitchid.model.inverse_table import InverseTable, make_inverse_table
from hitchid.model.limits import TravelLimits
from hitchid.model.linear import linear_model
from hitchid.model.operating_point import Numbers
from hitchid.model.packing import Packed
from hitchid.model.parameters import ParameterTable, parameter_table
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.model.set_by_hand import with_parameters
from hitchid.model.speed import SteadySpeed, speed_with_band
from hitchid.model.state import HitchState
from hitchid.model.step import StepFunctions, join_inputs
from hitchid.model.uncertainty import Uncertainty

if TYPE_CHECKING:
    import control
    from scipy import signal


@dataclass(frozen=True)
class Hitch:
    """Grey-box model of a hitch with one channel for each direction, or with a single channel.

    Attributes:
        channels: direction to channel.
        step_s: sampling time, s.
        units: role to unit of the model; records in other units are converted.
        provenance: tests, settings and versions of the identification.
        drift: speed of a piston that is held, in the displacement's unit/s.
        two_modes: test for two modes; None where it was not possible.
        uncertainty: direction to the uncertainty of its channel; empty where it was not computed.
        comparison: direction to the models fitted to the same tests for comparison only.
    """

    channels: Mapping[str, Channel]
    step_s: float
    units: Mapping[str, str]
    provenance: Provenance = field(default_factory=Provenance)
    drift: float = 0.0
    two_modes: TwoModes | None = None
    uncertainty: Mapping[str, Uncertainty] = field(default_factory=dict)
    comparison: Mapping[str, Comparison] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make channels and units read-only, and sort channels in the order of `DIRECTIONS`."""
        ordered = {
            direction: self.channels[direction] for direction in DIRECTIONS if direction in self.channels
        }
        object.__setattr__(self, "channels", MappingProxyType(ordered))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @double_precision
    def extrapolation(self, record: Record) -> tuple[str, ...]:
        """Return a sentence for each signal of a free run outside the operating range of the tests.

        More than a tenth of a range outside, the free run is that of the benchmark without compensator.

        Args:
            record: as in `simulate`.

        Raises:
            InputError: as `simulate`.
        """
        model_record = self.to_model_units(record)
        return extrapolation.warnings(self.channels, self.units, model_record, self.free_run(model_record))

    @property
    def limits(self) -> TravelLimits | None:
        """Limits of the displacement in free run; None in a model without limits."""
        return next((channel.limits for channel in self.channels.values()), None)

    def describe_range(self, direction: str, name: str) -> str:
        """Return the range of a signal in the identification tests of a direction as text.

        Args:
            direction: direction of a channel.
            name: `command`, `displacement` or `load`.
        """
        return extrapolation.describe_range(self.channels[direction], self.units, name)

    @property
    def dead_zones(self) -> dict[str, float]:
        """Direction to dead zone of its command, in the command's unit."""
        return {direction: channel.dead_zone for direction, channel in self.channels.items()}

    def command_thresholds(self, units: Mapping[str, str]) -> dict[str, CommandThreshold]:
        """Return direction to the threshold of its command: dead zone, hysteresis, dead time.

        Args:
            units: role to unit of the logs.

        Raises:
            InputError: a unit is of another dimension than the model's.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        thresholds = {}
        for direction, channel in self.channels.items():
            benchmark = channel.benchmark
            hysteresis = benchmark.named_values().get("hysteresis", 0.0)
            dead_zone = channel.dead_zone * self._command_factor(direction, units)
            thresholds[direction] = CommandThreshold(
                dead_zone, hysteresis * dead_zone, float(benchmark.dead_time_s)
            )
        return thresholds

    def segmentation_dead_zones(self, units: Mapping[str, str]) -> dict[str, float]:
        """Return direction to the dead zone with which mixed cycles are cut into strokes.

        Args:
            units: role to unit of the logs.

        Raises:
            InputError: a unit is of another dimension than the model's.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        dead_zones = self.provenance.segmentation_dead_zones or self.dead_zones
        return {
            direction: dead_zone * self._command_factor(direction, units)
            for direction, dead_zone in dead_zones.items()
        }

    def _command_factor(self, direction: str, units: Mapping[str, str]) -> float:
        role = COMMAND[direction]
        convertible = role in self.units and role in units
        return conversion_factor(self.units[role], units[role], role) if convertible else 1.0

    @double_precision
    def init_state(self, displacement: float, load: float = 0.0) -> Packed:
        """Return the state of a hitch at rest with closed valves.

        Args:
            displacement: initial displacement, in the model's unit.
            load: covariate before motion, in the model's unit, where a channel has one.

        Raises:
            InputError: a value is not finite, or beyond 1e9.
        """
        numbers = []
        for name, value in (("displacement", displacement), ("load", load)):
            numbers.append(checks.number(value, name))
            if not abs(numbers[-1]) < MAX_MAGNITUDE:
                raise InputError(f"{name}: expected a number within ±{MAX_MAGNITUDE:g}, got {value}")
        return self._step_functions.init_state(*numbers)

    def step(
        self, state: Packed, commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike | None = None
    ) -> tuple[Packed, Array]:
        """Return state and displacement one sampling time later: y(k+1) from c(k) and y(k).

        A pure function that `jax.jit` can trace. A command that is not finite keeps its last value; without
        a measured displacement the model continues from its own output.

        Args:
            state: state from `init_state` or an earlier step; see `unpack_state`.
            commands: lifting and lowering command until the next sample, in the model's unit, shape [2]; that
                of a direction without a channel is ignored. A model of one channel also accepts its command
                alone, shape [1].
            measured: displacement now, in the model's unit; None or NaN where there is none.

        Returns:
            The next state and its displacement, in the model's unit, shape [].

        Raises:
            InputError: the state is not of this model, or commands or measurement have another shape.
        """
        functions = self._step_functions
        with jax.enable_x64(True):
            functions.check(state)
            inputs = join_inputs(commands, np.nan if measured is None else measured, tuple(self.channels))
            return functions.step(state, inputs)

    def unpack_state(self, state: Packed) -> HitchState:
        """Return a packed state as a record: displacement, channel in charge, missing inputs.

        Raises:
            InputError: the state is not of this model.
        """
        with jax.enable_x64(True):
            self._step_functions.check(state)
            return self._step_functions.unpack(state)

    @double_precision
    def simulate(self, record: Record, *, compensated: bool = True) -> np.ndarray:
        """Return the free run: displacement from the commands and the initial displacement alone.

        One `step` for each sample; docs/switching.md describes the change of direction.

        Args:
            record: commands, and displacement, of which only the mean before motion is used.
            compensated: False for a simulation without compensators.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: the record cannot be converted to the model's units, see `to_model_units`.
        """
        model_record = self.to_model_units(record)
        return self._to_record_units(
            self.free_run(model_record, compensated=compensated).displacement, model_record, record
        )

    def predict(self, record: Record, *, horizon: int = 1) -> np.ndarray:
        """Return the prediction of each sample from displacement measured up to `horizon` samples before.

        The first `horizon` samples are predicted from the first one. All commands are taken as known.

        Args:
            record: commands and displacement.
            horizon: prediction horizon, in samples, at least 1.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: the horizon is below 1, or as `simulate`.
        """
        return self.predictions(record, (horizon,))[0]

    @double_precision
    def predictions(self, record: Record, horizons: Sequence[int], *, stride: int = 1) -> np.ndarray:
        """Return `predict` for several horizons at once, shape [H, N].

        Args:
            record, horizons: record and several horizons, as in `predict`.
            stride: only every `stride`-th sample is predicted; the others are NaN.

        Raises:
            InputError: there is no horizon, a horizon or the stride is below 1, or as `simulate`.
        """
        horizons = [checks.integer(horizon, "horizon", minimum=1) for horizon in horizons]
        if not horizons:
            raise InputError("horizons: expected at least one number of samples, got none")
        checks.integer(stride, "stride", minimum=1)
        model_record = self.to_model_units(record)
        initial = conversion.initial_condition(model_record, self.channels)
        rows = multi_step_predictions(self._dynamics, model_record, initial, horizons, stride)
        return np.stack([self._to_record_units(row, model_record, record) for row in rows])

    @double_precision
    def free_run(self, record: Record, *, compensated: bool = True) -> FreeRun:
        """Return the free run of a record, and the channel in charge at each sample.

        Args:
            record: on the model's clock and in its units; see `to_model_units`.
            compensated: False for a simulation without compensators.
        """
        initial = conversion.initial_condition(record, self.channels)
        return free_run(self._free_run_dynamics(compensated=compensated), record, initial)

    @double_precision
    def band(self, record: Record, *, coverage: float = 0.9, horizon: int | None = None) -> Band:
        """Return the band that contains the measured displacement for a share of the samples of a test.

        In free run the half width is √(z² n² + Σ q² w² (y_a − y)²), the sum over the ensembles of all
        channels; see `Bands`. For predictions it is that of the channel in charge.

        Args:
            record: as in `simulate`, or with a horizon as in `predict`.
            coverage: share of samples, 0.5 to 0.95.
            horizon: prediction horizon, in samples; None for free run.

        Raises:
            InputError: the model has no bands or none for this coverage, or as `simulate`.
        """
        checks.number(coverage, "coverage")
        bands = self._bands
        missing = [direction for direction in self.channels if direction not in bands]
        if missing:
            raise InputError(
                f"the model has no bands for {' and '.join(missing)}; expected at least three tests to "
                "identify it from"
            )
        model_record = self.to_model_units(record)
        run = self.free_run(model_record)
        if horizon is None:
            centre = self._to_record_units(run.displacement, model_record, record)
            initial = conversion.initial_condition(model_record, self.channels)
            half_width = hitch_half_width(
                self._free_run_dynamics(),
                [bands[name] for name in self.channels],
                model_record,
                initial,
                run,
                coverage,
            )
        else:
            checks.integer(horizon, "horizon", minimum=1)
            half_widths = [bands[direction].half_width(coverage, horizon) for direction in self.channels]
            centre = self.predict(record, horizon=horizon)
            half_width = np.where(
                run.active_channel < 0, max(half_widths), np.array(half_widths)[run.active_channel]
            )
        half_width = self._to_record_units(half_width, model_record, record)
        return Band(centre - half_width, centre + half_width)

    @property
    def has_bands(self) -> bool:
        """Whether every channel has bands around its predictions."""
        return len(self._bands) == len(self.channels)

    @property
    def _bands(self) -> dict[str, Bands]:
        all_bands = {
            direction: uncertainty.bands
            for direction, uncertainty in self.uncertainty.items()
            if direction in self.channels
        }
        return {direction: bands for direction, bands in all_bands.items() if bands is not None}

    @property
    def parameters(self) -> ParameterTable:
        """Parameters of all directions, with unit, standard error, 95 % interval and verdict."""
        return parameter_table(self)

    def with_parameters(
        self, *, lifting: Mapping[str, float] | None = None, lowering: Mapping[str, float] | None = None
    ) -> "Hitch":
        """Return a model with parameters set by hand, such as `lifting={"gain": 25}`.

        A changed direction loses what was computed for its old values: compensators, which were trained on
        the errors of the old benchmark, bands, which were calibrated with them, speed map, Fisher information
        and comparison models. The interval of a parameter that was not set stays only if its estimate hardly
        depends on the set ones, by at most a tenth of its standard error.

        Args:
            lifting, lowering: name, as in `parameters`, to value, in the unit there.

        Raises:
            InputError: the model has no such direction or parameter, or a value is not admissible.
        """
        return with_parameters(self, {"lifting": lifting, "lowering": lowering})

    def speed(
        self,
        command: Numbers,
        direction: str | None = None,
        *,
        displacement: Numbers | None = None,
        load: Numbers | None = None,
    ) -> SteadySpeed:
        """Return the steady speed at constant command, with its 95 % band: K w(c − d₀) g(x).

        That of a structure without an integrator is its speed at the start. Arrays broadcast.

        Args:
            command: as logged, in the model's unit.
            direction: of the channel; may be omitted in a model of one channel.
            displacement: where the piston is, in the model's unit; by default mid stroke.
            load: second measured input, in the model's unit; by default the mean of the tests.

        Raises:
            InputError: the structure has no speed map, or an argument does not fit.
        """
        return speed_with_band(self, command, direction, displacement=displacement, load=load)

    def inverse_table(
        self,
        direction: str | None = None,
        speeds: Numbers | None = None,
        *,
        displacement: float | None = None,
        load: float | None = None,
    ) -> InverseTable:
        """Return the command for each steady speed, the inverse of `speed`, as a table for a controller.

        Args:
            direction, displacement, load: as in `speed`.
            speeds: positive where the displacement grows; by default 33 from zero to the speed at the largest
                command of the tests.

        Raises:
            InputError: as `speed`, a speed cannot be reached, or the speed does not rise with the command.
        """
        return make_inverse_table(self, direction, speeds, displacement=displacement, load=load)

    def to_scipy(
        self,
        direction: str | None = None,
        step_s: float | None = None,
        *,
        command: float | None = None,
        displacement: float | None = None,
        load: float | None = None,
    ) -> "signal.StateSpace":
        """Return the linear state-space model of a direction as `scipy.signal` has it; see `to_control`."""
        point = {"command": command, "displacement": displacement, "load": load}
        return linear_model(self, direction, step_s, **point).to_scipy()

    def to_control(
        self,
        direction: str | None = None,
        step_s: float | None = None,
        *,
        command: float | None = None,
        displacement: float | None = None,
        load: float | None = None,
    ) -> "control.StateSpace":
        """Return the linear state-space model of a direction as python-control has it, without compensators.

        From the deviation of the command to that of the displacement, about an operating point. Without
        nonlinearities of valve and stroke it is exact beyond the dead zone, also from rest, for the command
        minus the dead zone. Otherwise its gain is that at the operating point; see
        `hitchid.structures.linearise`.

        Args:
            direction: of the channel; may be omitted in a model of one channel.
            step_s: sampling time, s, for the exact model of a held command; None for the continuous model,
                which a model with a dead time does not have.
            command, displacement, load: operating point, in the model's units; by default half way from
                the opening of the valve to the largest command, mid stroke, and mean load of the tests.

        Raises:
            InputError: the structure is not linear, the valve is closed at the operating point, the model is
                continuous and has a dead time, or python-control is not installed.
        """
        point = {"command": command, "displacement": displacement, "load": load}
        return linear_model(self, direction, step_s, **point).to_control()

    def to_model_units(self, record: Record) -> Record:
        """Return a record on the model's clock and in the model's units.

        Raises:
            InputError: the record has no command of any channel, an effective command without a channel, or
                a unit of another dimension than the model's.
        """
        return conversion.to_model_units(record, tuple(self.channels), self.units, self.step_s)

    @cached_property
    def _dynamics(self) -> HitchDynamics:
        return HitchDynamics.of(tuple(self.channels.values()), self.step_s, self.drift)

    def _free_run_dynamics(self, *, compensated: bool = True) -> HitchDynamics:
        """Return the dynamics without the compensator for predictions, or without any compensator."""
        removed = {"compensator": None} if compensated else {"compensator": None, "speed_compensator": None}
        channels = [replace(channel, **removed) for channel in self.channels.values()]
        return HitchDynamics.of(channels, self.step_s, self.drift)

    @cached_property
    def _step_functions(self) -> StepFunctions:
        return StepFunctions(self._dynamics)

    def _to_record_units(self, displacement: np.ndarray, model_record: Record, record: Record) -> np.ndarray:
        return conversion.to_record_units(displacement, self.units, model_record, record)
