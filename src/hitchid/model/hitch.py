"""Model of the whole plant: one channel for each direction, switched by the commands."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import jax
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from hitchid._support import checks
from hitchid._support.checks import named_arguments
from hitchid._support.precision import double_precision
from hitchid._support.records import Value
from hitchid._support.tables import Summarised, Table
from hitchid.errors import InputError
from hitchid.handover.linear import Handover
from hitchid.logs.kinds import CommandThreshold
from hitchid.logs.record import DIRECTIONS, Record
from hitchid.model import pickling, plotting, simulation
from hitchid.model.bands import Band, Bands, bands_by_channel
from hitchid.model.channel import Channel, command_thresholds, in_log_units
from hitchid.model.dynamics import MAX_MAGNITUDE, HitchDynamics
from hitchid.model.estimates import Uncertainty
from hitchid.model.free_run import last_measured, multi_step_predictions
from hitchid.model.inputs import (
    Commands,
    Frame,
    Load,
    Numbers,
    covariates_of,
    load_to_estimate,
    record_or_commands,
    required_record,
)
from hitchid.model.limits import TravelLimits
from hitchid.model.parameters import ParameterTable, hitch_summary, parameter_table, with_parameters
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.model.rivals import Rivals
from hitchid.model.simulation import SimulatedModel, Simulation, simulate
from hitchid.model.state import HitchState, Switching
from hitchid.model.step import LOAD_BANK_NDIM, STATE_REQUIRED, Packed, StepFunctions, join_inputs

if TYPE_CHECKING:
    from hitchid.live import Adaptation, AdaptationSettings, Event


@dataclass(frozen=True, eq=False, repr=False)
class Hitch(Value, Summarised, Handover):
    """Grey-box model of a hitch with one channel for each direction, or with a single channel.

    Attributes:
        channels: direction to channel.
        step_s: sampling time, s.
        units: role to unit of the model; records in other units are converted.
        provenance: tests, settings and versions of the identification.
        drift: speed of a piston that is held, in the displacement's unit/s.
        two_modes: test for two modes; None where it was not possible.
        uncertainty: direction to the uncertainty of its channel; empty where it was not computed.
        rivals: direction to the models fitted to the same tests for comparison only.
    """

    channels: Mapping[str, Channel]
    step_s: float
    units: Mapping[str, str]
    provenance: Provenance = field(default_factory=Provenance)
    drift: float = 0.0
    two_modes: TwoModes | None = None
    uncertainty: Mapping[str, Uncertainty] = field(default_factory=dict)
    rivals: Mapping[str, Rivals] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Make channels and units read-only, and sort channels in the order of `DIRECTIONS`."""
        # The order counts: with both valves open the last channel moves the piston, which is lowering.
        ordered = {name: self.channels[name] for name in DIRECTIONS if name in self.channels}
        object.__setattr__(self, "channels", MappingProxyType(ordered))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    def __reduce__(self) -> tuple:
        """Return the fields for `pickle` and `copy`."""
        return pickling.reduced(self)

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
        return simulation.describe_range(self.channels[direction], self.units, name)

    @property
    def has_trained_rivals(self) -> bool:
        """Whether rivals were trained beside it that are not fitted to every model."""
        return any(rivals.trained for rivals in self.rivals.values())

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
        return command_thresholds(self.channels, self.units, units)

    def segmentation_dead_zones(self, units: Mapping[str, str]) -> dict[str, float]:
        """Return direction to the dead zone with which mixed cycles are cut into strokes.

        Args:
            units: role to unit of the logs.

        Raises:
            InputError: a unit is of another dimension than the model's.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        dead_zones = self.provenance.segmentation_dead_zones or self.dead_zones
        return in_log_units(dead_zones, self.units, units)

    @double_precision
    def init_state(
        self, displacement: float, load: Load | Mapping[str, Numbers | None] | None = None
    ) -> Packed:
        """Return the state of a hitch at rest with closed valves.

        Args:
            displacement: initial displacement, in the model's unit.
            load: covariate before motion, in the model's unit, or several by name; by default the mean of the
                identification tests. None, by name, for one that is not measured: `step` then estimates it
                from the measured displacements.

        Raises:
            InputError: a value is beyond 1e9, the displacement is not finite, or there is no such covariate.
        """
        initial = checks.number(displacement, "displacement")
        row = load_to_estimate(load, tuple(self.channels.values()), "model")
        if row.ndim > 1:
            raise checks.input_error("load", "one load", load)
        measured = row[~np.isnan(row)]
        for name, value in (("displacement", initial), *(("load", value) for value in measured)):
            if not abs(value) < MAX_MAGNITUDE:
                raise InputError(f"{name}: expected a number within ±{MAX_MAGNITUDE:g}, got {value}")
        functions = self._step_functions if measured.size == row.size else self._load_bank_functions
        return functions.init_state(initial, row)

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
        with jax.enable_x64(True):
            functions = self._functions_of(state)
            inputs = join_inputs(commands, np.nan if measured is None else measured, tuple(self.channels))
            return functions.step(state, inputs)

    def unpack_state(self, state: Packed) -> HitchState:
        """Return a packed state as a record: displacement, channel in charge, missing inputs.

        Where a covariate is not measured it is the state at its most probable value, with the expected
        displacement.

        Raises:
            InputError: the state is not of this model.
        """
        with jax.enable_x64(True):
            return self._functions_of(state).unpack(state)

    def switching(self, state: Packed) -> Switching:
        """Return active channel, and whether both valves are open: `unpack_state` at a fraction of its time.

        Not for a state that `jax.jit` traces.

        Raises:
            InputError: the state is not of this model.
        """
        return self._functions_of(state).switching(state)

    @named_arguments
    @double_precision
    def simulate(
        self,
        commands: Record | Commands | str | Path,
        *,
        step_s: float | None = None,
        initial: Numbers | None = None,
        load: Load | None = None,
        compensated: bool = True,
    ) -> Simulation:
        """Return the free run: displacement from the commands and the initial displacement alone.

        One `step` for each sample. Change of direction: :doc:`/switching`. Several initial displacements or
        loads are simulated at the same time.

        Args:
            commands: a record, whose displacement and covariates count only before motion, or what is one: a
                DataFrame as `Record.from_dataframe` takes it, or the path of a log; or commands in the
                model's units: columns `lifting_command` and `lowering_command` of a mapping or DataFrame, an
                array of both, shape [N, 2], or one command, shape [N]: that of a model of one channel,
                otherwise positive for lifting and negative for lowering.
            step_s: sampling time of commands without a record, s; they are resampled as those of a log.
            initial: initial displacement, in the model's unit, shape [] or [M]; required without a record.
            load: covariate before motion, in the model's unit, shape [] or [M], or several by name; required
                without a record where the model has one.
            compensated: False for a simulation without compensators, which has no bands.

        Raises:
            InputError: an argument is missing or cannot be used, or the record cannot be converted to the
                model's units, see `to_model_units`.
        """
        dynamics = self.free_run_dynamics(compensated=compensated)
        model = SimulatedModel(dynamics, dict(self.units), self.bands if compensated else {})
        given = record_or_commands(commands, tuple(self.channels), step_s)
        return simulate(model, given, step_s=step_s, initial=initial, load=load)

    @named_arguments
    def predict(self, record: Record | Frame | str | Path, *, horizon: int = 1) -> np.ndarray:
        """Return the prediction of each sample from displacement measured up to `horizon` samples before.

        The first `horizon` samples are predicted from the first one. All commands are taken as known.

        Args:
            record: commands and displacement, or what `simulate` makes a record of.
            horizon: prediction horizon, in samples, at least 1.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: the horizon is below 1, or as `simulate`.
        """
        return self.predictions(record, (horizon,))[0]

    @named_arguments
    @double_precision
    def predictions(
        self, record: Record | Frame | str | Path, horizons: Sequence[int], *, stride: int = 1
    ) -> np.ndarray:
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
        record = required_record(record)
        model_record = self.to_model_units(record)
        initial = simulation.condition_before_motion(model_record, self.channels)
        rows = multi_step_predictions(self.dynamics, model_record, initial, horizons, stride)
        return np.stack([simulation.to_record_units(row, self.units, model_record, record) for row in rows])

    @named_arguments
    @double_precision
    def band(self, record: Record | Frame | str | Path, *, horizon: int, coverage: float = 0.9) -> Band:
        """Return the band around `predict` that contains the measured displacement for a share of samples.

        Its half width is that of the channel in charge and grows with the predicted movement since the last
        measured displacement; `Simulation.band` is the band of a free run.

        Args:
            record, horizon: as in `predict`.
            coverage: share of samples, 0.5 to 0.95.

        Raises:
            InputError: the model has no bands or none for this coverage, or as `predict`.
        """
        checks.number(coverage, "coverage")
        checks.integer(horizon, "horizon", minimum=1)
        bands = bands_by_channel(self.bands, tuple(self.channels))
        record = required_record(record)
        model_record = self.to_model_units(record)
        initial = simulation.condition_before_motion(model_record, self.channels)
        (predicted,) = multi_step_predictions(self.dynamics, model_record, initial, (horizon,), 1)
        movement = predicted - last_measured(model_record.displacement, float(initial.displacement), horizon)
        half_widths = np.stack([own.half_width(coverage, horizon, movement) for own in bands])
        # From the commands alone; before the first effective one no channel is in charge: the widest band.
        active_channel = self.simulate(record).run.active_channel
        by_channel = np.take_along_axis(half_widths, np.maximum(active_channel, 0)[None], axis=0)[0]
        rows = predicted, np.where(active_channel < 0, half_widths.max(axis=0), by_channel)
        centre, half_width = (
            simulation.to_record_units(row, self.units, model_record, record) for row in rows
        )
        return Band(centre - half_width, centre + half_width)

    @property
    def has_bands(self) -> bool:
        """Whether every channel has bands around its predictions."""
        return len(self.bands) == len(self.channels)

    @property
    def bands(self) -> dict[str, Bands]:
        """Direction to the bands of its channel; without those that have none."""
        return {
            direction: uncertainty.bands
            for direction, uncertainty in self.uncertainty.items()
            if direction in self.channels and uncertainty.bands is not None
        }

    @named_arguments
    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the model to a folder, for `hitchid.load`; see `hitchid.save`.

        Args:
            folder: folder to write; must not exist unless `force`.
            force: replace an existing model folder.

        Raises:
            InputError: `folder` is not a path.
            OutputError: the folder exists, or cannot be written.
        """
        from hitchid.model.folder import save

        save(self, folder, force=force)

    @property
    def parameters(self) -> ParameterTable:
        """Parameters of all directions, with unit, standard error, 95 % interval and verdict."""
        return parameter_table(self)

    @named_arguments
    def with_parameters(
        self, *, lifting: Mapping[str, float] | None = None, lowering: Mapping[str, float] | None = None
    ) -> "Hitch":
        """Return a model with parameters set by hand, such as `lifting={"gain": 25}`.

        A changed direction loses what was computed for its old values: compensators, which were trained on
        the errors of the old benchmark, bands, which were calibrated with them, speed map, Fisher information
        and rivals. The interval of a parameter that was not set stays only if its estimate hardly
        depends on the set ones, by at most a tenth of its standard error.

        Args:
            lifting, lowering: name, as in `parameters`, to value, in the unit there.

        Raises:
            InputError: the model has no such direction or parameter, or a value is not admissible.
        """
        return with_parameters(self, {"lifting": lifting, "lowering": lowering})

    @named_arguments
    def adapt(
        self,
        records: Iterable[Record],
        *,
        settings: "AdaptationSettings | None" = None,
        load: Load | None = None,
        earlier: Sequence["Event"] = (),
    ) -> "Adaptation":
        """Return what the model learns from logs of a machine that has changed, one after the other.

        From each stroke gain and dead zone are estimated; a change takes effect where it proved better on
        strokes that came after it was made. See :doc:`/howto/adaptation`.

        Args:
            records: logs in the order of their time, such as `campaign.records`.
            settings: of the adaptation; the defaults where None.
            load: covariate before motion, or several by name; by default the mean of the tests.
            earlier: events of a change log to go on from.

        Raises:
            InputError: the model was adapted already, a channel has no gain behind a dead zone, or a record
                cannot be converted to the model's units.
        """
        from hitchid.live.adapter import adapt

        return adapt(self, records, settings=settings, load=load, earlier=earlier)

    def to_model_units(self, record: Record) -> Record:
        """Return a record on the model's clock and in the model's units.

        Raises:
            InputError: the record has no command of any channel, an effective command without a channel, or
                a unit of another dimension than the model's.
        """
        return simulation.to_model_units(record, tuple(self.channels), self.units, self.step_s)

    plot = plotting.plot_speed_map
    plot_step_response = plotting.plot_step_response
    plot_bode = plotting.plot_bode

    @cached_property
    def dynamics(self) -> HitchDynamics:
        """Dynamics of the whole model, with the compensators for predictions."""
        return HitchDynamics.of(tuple(self.channels.values()), self.step_s, self.drift)

    def free_run_dynamics(self, *, compensated: bool = True) -> HitchDynamics:
        """Return the dynamics without the compensator for predictions, or without any compensator."""
        # The network for predictions corrects from what was measured, which a free run has not.
        removed = {"compensator": None} if compensated else {"compensator": None, "speed_compensator": None}
        channels = [replace(channel, **removed) for channel in self.channels.values()]
        return HitchDynamics.of(channels, self.step_s, self.drift)

    @cached_property
    @double_precision
    def _step_functions(self) -> StepFunctions:
        return StepFunctions.of(self.dynamics)

    @cached_property
    @double_precision
    def _load_bank_functions(self) -> StepFunctions:
        return StepFunctions.at_unknown_load(self.dynamics)

    def _functions_of(self, state: Packed) -> StepFunctions:
        """Return the functions that a state is of; raises InputError where it is not of this model."""
        checks.instance(state, Packed, "state", STATE_REQUIRED)
        # By shapes alone, as a state may be traced. Without covariates there is no hitch at many loads.
        at_many_loads = np.ndim(state.hidden) == LOAD_BANK_NDIM and covariates_of(self.channels.values())
        functions = self._load_bank_functions if at_many_loads else self._step_functions
        if not functions.accepts(state):
            raise checks.input_error("state", STATE_REQUIRED, tuple(map(np.shape, state)))
        return functions

    def _summary(self) -> Table:
        return hitch_summary(self)
