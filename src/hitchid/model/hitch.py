"""The whole plant: one channel a direction, switched by the commands."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float
from scipy.special import ndtri

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT, Record
from hitchid.data.segmentation import CommandThreshold
from hitchid.data.test_kinds import ACTIVE_FRACTION, effective_command, full_scales
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.dynamics import MAX_MAGNITUDE, HitchDynamics, HitchState
from hitchid.model.ensemble import perturbed_channel
from hitchid.model.limits import TravelLimits
from hitchid.model.packing import Packed, Packing
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.model.runs import (
    FreeRun,
    InitialCondition,
    align_predictions,
    pad_with_nan,
    predict_from_origins,
    simulate_ensemble,
    simulate_free_run,
)
from hitchid.structures import Batch, mean_before_motion
from hitchid.uncertainty import Bands, Uncertainty


class Band(NamedTuple):
    """Between what displacement is expected, in the record's unit, each of shape [N]."""

    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True)
class Hitch:
    """A dual-mode grey box, or one with a single channel.

    Attributes:
        channels: mode to channel.
        step_s: sampling time, s.
        units: role to unit; what goes in and comes out of `simulate` is in these or converted to them.
        provenance: where the model comes from.
        drift: speed of a piston that is held, in the displacement's unit/s.
        two_modes: whether the plant needs two modes; None where that could not be asked.
        uncertainty: mode to how far its channel can be trusted; without a mode it was not asked for.
    """

    channels: Mapping[str, Channel]
    step_s: float
    units: Mapping[str, str]
    provenance: Provenance = field(default_factory=Provenance)
    drift: float = 0.0
    two_modes: TwoModes | None = None
    uncertainty: Mapping[str, Uncertainty] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Freeze the mappings, channels in the order of the modes."""
        ordered = {
            direction: self.channels[direction] for direction in DIRECTIONS if direction in self.channels
        }
        object.__setattr__(self, "channels", MappingProxyType(ordered))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @double_precision
    def extrapolation(self, record: Record) -> tuple[str, ...]:
        """Tell in words where a free run leaves what the identification tests covered.

        Beyond a tenth of a range the compensator for free run has faded out and the benchmark alone answers.

        Args:
            record: as `simulate` takes it.

        Raises:
            InputError: as `simulate`.
        """
        model_record = self.to_model_units(record)
        displacement, active_channel = self.free_run(model_record)
        warnings = []
        for number, (direction, channel) in enumerate(self.channels.items()):
            in_charge = active_channel == number
            batch = channel.batch([model_record], [float(displacement[0])])
            rows = channel.out_of_range(batch, jnp.asarray(_padded_to_batch(displacement, batch))[None])
            for name, is_outside in rows.items():
                samples = int(np.sum(is_outside[0, : len(model_record)] & in_charge))
                if samples:
                    warnings.append(
                        f"{direction}: the {name} leaves what the tests covered, {self.describe_range(direction, name)}, in "
                        f"{samples} of {len(model_record)} samples"
                    )
        return (*warnings, *self._at_limits(displacement))

    def _at_limits(self, displacement: np.ndarray) -> list[str]:
        """Tell in words where a free run is held at a limit of the plant that is no mechanical stop."""
        samples = 0 if self.limits is None else int(np.sum(self.limits.at_soft_limit(displacement)))
        if not samples or self.limits is None:
            return []
        unit = self.units[DISPLACEMENT]
        return [f"{self.limits.sentence(unit)}; this one is in {samples} of {displacement.size} samples"]

    @property
    def limits(self) -> TravelLimits | None:
        """Between what displacements a free run is held; None in models that know no limits."""
        return next((channel.limits for channel in self.channels.values()), None)

    def describe_range(self, direction: str, name: str) -> str:
        """Return in words from where to where the tests of a mode went.

        Args:
            direction: of a channel that knows it.
            name: `command`, `displacement` or `load`.
        """
        channel = self.channels[direction]
        load = channel.benchmark.covariate or ""
        role = {"command": COMMAND[direction], "displacement": DISPLACEMENT, "load": load}[name]
        signal_range = getattr(channel.envelope, name)
        suffix = " beyond the dead zone" if name == "command" else ""
        ends = f"{float(signal_range.lowest):.4g} to {float(signal_range.highest):.4g}"
        return f"{ends} {self.units.get(role, '')}{suffix}"

    @property
    def dead_zones(self) -> dict[str, float]:
        """Mode to dead zone, in the command's unit."""
        return {direction: channel.dead_zone for direction, channel in self.channels.items()}

    def command_thresholds(self, units: Mapping[str, str]) -> dict[str, CommandThreshold]:
        """Return mode to how it hears its command: dead zone, hysteresis, dead time.

        Args:
            units: role to unit of the logs that are looked at.

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
        """Return mode to the dead zone with which mixed cycles are cut into strokes.

        Args:
            units: role to unit of the logs that are cut.

        Raises:
            InputError: a unit is of another dimension than the model's.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        dead_zones = self.provenance.cut_at or self.dead_zones
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
        """Return the state of a hitch that stands, its valves shut.

        Args:
            displacement: in the model's unit.
            load: second measured input before motion, in its unit, where a channel hears one.

        Raises:
            InputError: a value is not finite, or beyond 1e9.
        """
        numbers = []
        for name, value in (("displacement", displacement), ("load", load)):
            numbers.append(checks.number(value, name))
            if not abs(numbers[-1]) < MAX_MAGNITUDE:
                raise InputError(f"{name}: required a number within ±{MAX_MAGNITUDE:g}, came {value}")
        return self._jitted_init_state(*numbers)

    def step(
        self, state: Packed, commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike | None = None
    ) -> tuple[Packed, Array]:
        """Return the state one sampling time later, and the displacement then: y(k+1) from c(k) and y(k).

        Pure, and may be traced by `jax.jit`. What is missing is coasted over: a command that is not finite
        keeps its last value, and without a measured displacement the model goes on from its own.

        Args:
            state: from `initial` or an earlier step; `situation` tells what is in it.
            commands: lifting and lowering command over the coming interval, in the model's unit, shape [2];
                a mode without a channel is not heard. A model of one channel takes its command alone, too,
                shape [1].
            measured: displacement now, in the model's unit; None or NaN where there is none.

        Returns:
            The next state and its displacement, in the model's unit, shape [].

        Raises:
            InputError: the state is none of this model, or commands or measurement have another shape.
        """
        with jax.enable_x64(True):
            self._check_state(state)
            return self._jitted_step(
                state, self._join_inputs(commands, np.nan if measured is None else measured)
            )

    def unpack_state(self, state: Packed) -> HitchState:
        """Return what a state says: displacement, channel in charge, what is missing.

        Raises:
            InputError: the state is none of this model.
        """
        with jax.enable_x64(True):
            self._check_state(state)
            return self._jitted_unpack(state)

    @double_precision
    def simulate(self, record: Record, *, compensated: bool = True) -> np.ndarray:
        """Return the free run: displacement from the commands and the initial displacement alone.

        One `step` a sample; see there, and docs/switching.md for what happens where the mode changes.

        Args:
            record: supplies commands, and displacement for the mean of the first samples before motion.
            compensated: False leaves the compensators out.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: a command is effective that the model has no channel for.
            InputError: a unit is of another dimension than the model's.
        """
        model_record = self.to_model_units(record)
        return self._to_record_units(
            self.free_run(model_record, compensated=compensated).displacement, model_record, record
        )

    def predict(self, record: Record, *, horizon: int = 1) -> np.ndarray:
        """Return each sample predicted from the displacement measured `horizon` samples before and earlier.

        The first `horizon` samples are predicted from the first one. Commands are known throughout.

        Args:
            record: supplies commands and displacement.
            horizon: samples to look ahead, at least 1.

        Returns:
            Displacement at every sample, in the unit of the record's displacement, shape [N].

        Raises:
            InputError: the horizon is below 1, or as `simulate`.
            InputError: a unit is of another dimension than the model's.
        """
        return self.predictions(record, (horizon,))[0]

    @double_precision
    def predictions(self, record: Record, horizons: Sequence[int], *, stride: int = 1) -> np.ndarray:
        """Return `predict` for several horizons at once, shape [H, N].

        Args:
            record, horizons: as `predict` takes them.
            stride: predict from one sample in so many; what is not predicted is NaN.
        """
        horizons = [checks.integer(horizon, "horizon", minimum=1) for horizon in horizons]
        if not horizons:
            raise InputError("horizons: required at least one number of samples, none came")
        checks.integer(stride, "stride", minimum=1)
        model_record = self.to_model_units(record)
        max_horizon = min(max(horizons), len(model_record))
        commands = pad_with_nan(_commands(model_record), max_horizon)
        measured = pad_with_nan(model_record.displacement, max_horizon)
        initial = self._initial_condition(model_record)
        predictions_ahead = np.asarray(
            predict_from_origins(self._dynamics, jnp.array(initial), commands, measured, max_horizon, stride)
        )
        rows = [
            align_predictions(
                predictions_ahead, initial.displacement, min(horizon, max_horizon), len(model_record), stride
            )
            for horizon in horizons
        ]
        return np.stack([self._to_record_units(row, model_record, record) for row in rows])

    @double_precision
    def free_run(self, record: Record, *, compensated: bool = True) -> FreeRun:
        """Return the free run of an adopted record, and which channel is in charge.

        Args:
            record: on the model's clock and in its units; see `adopt`.
            compensated: False leaves the compensators out.
        """
        initial = self._initial_condition(record)
        commands = pad_with_nan(_commands(record), 1)
        displacement, active_channel = simulate_free_run(
            self._free_run_dynamics(compensated=compensated), jnp.array(initial), commands
        )
        count = len(record) - 1
        return FreeRun(
            _with_first_sample(initial, np.asarray(displacement)[:count]),
            np.concatenate(
                [np.asarray(active_channel)[:count], np.asarray(active_channel)[count - 1 : count]]
            ),
        )

    @double_precision
    def band(self, record: Record, *, coverage: float = 0.9, horizon: int | None = None) -> Band:
        """Return between what the measured displacement will lie, for a share of the samples of a test.

        In free run the half width is √(z² n² + Σ q² w² (y_a − y)²), the sum over the alternatives of every
        channel; see `Bands`. Looking ahead it is that of the channel in charge.

        Args:
            record: as `simulate` takes it, or with a horizon as `predict` does.
            coverage: share of samples, 0.5 to 0.95.
            horizon: samples to look ahead; None for free run.

        Raises:
            InputError: the model has no bands, the share lies beyond them, or as `simulate`.
            InputError: a unit is of another dimension than the model's.
        """
        checks.number(coverage, "coverage")
        bands = self._bands
        missing = [direction for direction in self.channels if direction not in bands]
        if missing:
            raise InputError(
                f"the model has no bands for {' and '.join(missing)}; required at least three tests to "
                "identify it from"
            )
        model_record = self.to_model_units(record)
        run = self.free_run(model_record)
        if horizon is None:
            centre = self._to_record_units(run.displacement, model_record, record)
            half_width = self._free_run_half_width(model_record, run, bands, coverage)
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

    def _free_run_half_width(
        self, model_record: Record, run: FreeRun, bands: Mapping[str, Bands], coverage: float
    ) -> Float[np.ndarray, " n"]:
        floor = [ndtri(0.5 + coverage / 2) * channel_bands.noise for channel_bands in bands.values()]
        perturbed_dynamics, factors = [], []
        for direction, channel in self.channels.items():
            for member in bands[direction].alternatives:
                perturbed = replace(
                    self, channels={**self.channels, direction: perturbed_channel(channel, member)}
                )
                perturbed_dynamics.append(perturbed._free_run_dynamics())
                factors.append(bands[direction].multiplier(coverage) * member.weight)
        initial = self._initial_condition(model_record)
        runs = simulate_ensemble(
            perturbed_dynamics, jnp.array(initial), pad_with_nan(_commands(model_record), 1)
        )[:, : len(model_record) - 1]
        deviations = np.stack([_with_first_sample(initial, row) for row in runs]) - run.displacement
        return np.sqrt(
            float(max(floor)) ** 2 + np.sum((np.array(factors)[:, None] * deviations) ** 2, axis=0)
        )

    def to_model_units(self, record: Record) -> Record:
        """Return a record on the model's clock and in the model's units.

        Raises:
            InputError: the record has no command for any channel, or one effective that no channel hears.
            InputError: a unit is of another dimension than the model's.
        """
        checks.instance(record, Record, "record", 'one of hitchid.read("logs").records')
        if not any(direction in record.directions for direction in self.channels):
            raise InputError(
                f"record '{record.name}' has commands for {' and '.join(record.directions)}; "
                f"the model has channels for {' and '.join(self.channels)}"
            )
        converted = record.convert(
            {role: unit for role, unit in self.units.items() if role in record.signals}
        )
        resampled = (
            converted
            if _same_clock(converted.step_s, self.step_s, len(converted))
            else converted.resample(self.step_s)
        )
        scales = full_scales([record])
        for direction in record.directions:
            active = np.abs(record.command(direction)) > ACTIVE_FRACTION * scales[direction]
            if direction not in self.channels and np.any(active):
                raise InputError(
                    f"record '{record.name}': its {direction} command is not zero; the model has no {direction} channel"
                )
        return resampled

    @cached_property
    def _dynamics(self) -> HitchDynamics:
        return HitchDynamics.of(tuple(self.channels.values()), self.step_s, self.drift)

    def _free_run_dynamics(self, *, compensated: bool = True) -> HitchDynamics:
        """Return the motion without what predicts from measurements, or without any compensator."""
        removed = {"compensator": None} if compensated else {"compensator": None, "speed_compensator": None}
        channels = [replace(channel, **removed) for channel in self.channels.values()]
        return HitchDynamics.of(channels, self.step_s, self.drift)

    def _check_state(self, state: Packed) -> None:
        """Refuse what is no state of this model; shapes alone are looked at, so that it may be traced."""
        required = "a state of this model, from `initial` or `step`"
        checks.instance(state, Packed, "state", required)
        if tuple(map(np.shape, state)) != self._state_shapes:
            raise checks.input_error("state", required, tuple(map(np.shape, state)))

    @cached_property
    def _packing(self) -> Packing:
        return Packing(jax.eval_shape(self._dynamics.standing_state))

    @cached_property
    def _jitted_init_state(self) -> Callable[[float, float], Packed]:
        dynamics, packing = self._dynamics, self._packing
        return jax.jit(lambda displacement, load: packing.pack(dynamics.init_state(displacement, load)))

    @cached_property
    def _jitted_unpack(self) -> Callable[[Packed], HitchState]:
        return jax.jit(self._packing.unpack)

    @cached_property
    def _jitted_step(self) -> Callable[..., tuple[Packed, Array]]:
        return self._packing.step(self._dynamics)

    @cached_property
    def _state_shapes(self) -> tuple[tuple[int, ...], ...]:
        return tuple(array.shape for array in jax.eval_shape(self._jitted_init_state, 0.0, 0.0))

    def _join_inputs(
        self, commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike
    ) -> Array | np.ndarray:
        """Return lifting and lowering command and measured displacement in one array, shape [3]."""
        values = commands if isinstance(commands, Sequence) else (commands,)
        xp = jnp if any(isinstance(value, jax.Array) for value in (*values, measured)) else np
        try:
            command_array, measured_array = xp.asarray(commands), xp.asarray(measured)
        except (TypeError, ValueError) as error:
            raise checks.input_error("commands, measured", "numbers", (commands, measured)) from error
        if {command_array.dtype.kind, measured_array.dtype.kind} - set("iuf"):
            raise checks.input_error("commands, measured", "numbers", (commands, measured))
        if command_array.shape == (1,) and len(self.channels) == 1:
            (direction,) = self.channels
            command_array = xp.zeros(len(DIRECTIONS)) + command_array * np.array(
                [name == direction for name in DIRECTIONS]
            )
        if command_array.shape != (len(DIRECTIONS),):
            raise InputError(
                f"commands: required lifting and lowering, shape (2,), came shape {command_array.shape}"
            )
        if measured_array.shape != ():
            raise InputError(
                f"measured: required one displacement, shape (), came shape {measured_array.shape}"
            )
        return xp.append(command_array, measured_array).astype(np.float64)

    def _initial_condition(self, record: Record) -> InitialCondition:
        """Return where a hitch stands before a record: the means before any command becomes effective."""
        effective = np.zeros(len(record))
        for direction, channel in self.channels.items():
            if direction in record.directions:
                effective += np.abs(effective_command(record.command(direction), channel.dead_zone))
        load = next((c.benchmark.covariate for c in self.channels.values() if c.benchmark.covariate), None)
        record.require(load)
        return InitialCondition(
            mean_before_motion(record.displacement, effective),
            0.0 if load is None else mean_before_motion(record.signals[load], effective),
        )

    def _to_record_units(self, displacement: np.ndarray, model_record: Record, record: Record) -> np.ndarray:
        """Return a displacement on the model's clock and in its unit on the record's, in the record's."""
        factor = conversion_factor(self.units[DISPLACEMENT], record.unit, record.name)
        if model_record.step_s != record.step_s:
            displacement = np.interp(record.time_s, model_record.time_s, displacement)
        return displacement * factor


def _with_first_sample(
    initial: InitialCondition, displacement: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n1"]:
    """Return a free run from its first sample on."""
    return np.concatenate([[initial.displacement], displacement])


def _same_clock(step_s: float, wanted_s: float, samples: int) -> bool:
    return abs(step_s - wanted_s) * samples <= 0.05 * wanted_s


def _commands(record: Record) -> Float[np.ndarray, "n 2"]:
    """Return lifting and lowering command, zero where there is none, shape [N, 2]."""
    zeros = np.zeros(len(record))
    return np.stack(
        [record.command(direction) if direction in record.directions else zeros for direction in DIRECTIONS],
        axis=1,
    )


def _padded_to_batch(samples: np.ndarray, batch: Batch) -> np.ndarray:
    return np.pad(samples, (0, batch.command.shape[1] - samples.size), mode="edge")
