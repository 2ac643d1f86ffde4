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
from hitchid.data.record import COMMAND, DISPLACEMENT, MODES, Record
from hitchid.data.segmentation import Switch
from hitchid.data.test_kinds import ACTIVE_FRACTION, effective_command, full_scales
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.limits import TravelLimits
from hitchid.model.packing import Packed, Packing
from hitchid.model.possible import possible
from hitchid.model.provenance import Provenance, TwoModes
from hitchid.model.runs import FreeRun, Rest, ahead_of, from_origins, padded, stepped, stepped_abreast
from hitchid.model.stepping import LARGEST, Motion, State
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
        ordered = {mode: self.channels[mode] for mode in MODES if mode in self.channels}
        object.__setattr__(self, "channels", MappingProxyType(ordered))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @double_precision
    def extrapolation(self, record: Record) -> tuple[str, ...]:
        """Tell in words where a free run leaves what the identification tests covered.

        Beyond a tenth of a range the compensator for free run has faded out and the benchmark alone answers.

        Args:
            record: as `simulate` takes it.

        Raises:
            InputError, SettingsError: as `simulate`.
        """
        own = self.adopt(record)
        displacement, charge = self.free_run(own)
        found = []
        for number, (mode, channel) in enumerate(self.channels.items()):
            driven = charge == number
            batch = channel.batch([own], [float(displacement[0])])
            rows = channel.outside(batch, jnp.asarray(_widened(displacement, batch))[None])
            for name, outside in rows.items():
                samples = int(np.sum(outside[0, : len(own)] & driven))
                if samples:
                    found.append(
                        f"{mode}: the {name} leaves what the tests covered, {self.covered(mode, name)}, in "
                        f"{samples} of {len(own)} samples"
                    )
        return (*found, *self._at_limits(displacement))

    def _at_limits(self, displacement: np.ndarray) -> list[str]:
        """Tell in words where a free run is held at a limit of the plant that is no mechanical stop."""
        samples = 0 if self.limits is None else int(np.sum(self.limits.reached(displacement)))
        if not samples or self.limits is None:
            return []
        unit = self.units[DISPLACEMENT]
        return [f"{self.limits.sentence(unit)}; this one is in {samples} of {displacement.size} samples"]

    @property
    def limits(self) -> TravelLimits | None:
        """Between what displacements a free run is held; None in models that know no limits."""
        return next((channel.limits for channel in self.channels.values()), None)

    def covered(self, mode: str, name: str) -> str:
        """Return in words from where to where the tests of a mode went.

        Args:
            mode: of a channel that knows it.
            name: `command`, `displacement` or `load`.
        """
        channel = self.channels[mode]
        load = channel.benchmark.load or ""
        role = {"command": COMMAND[mode], "displacement": DISPLACEMENT, "load": load}[name]
        covered = getattr(channel.envelope, name)
        beyond = " beyond the dead zone" if name == "command" else ""
        ends = f"{float(covered.lowest):.4g} to {float(covered.highest):.4g}"
        return f"{ends} {self.units.get(role, '')}{beyond}"

    @property
    def dead_zones(self) -> dict[str, float]:
        """Mode to dead zone, in the command's unit."""
        return {mode: channel.dead_zone for mode, channel in self.channels.items()}

    def switches(self, units: Mapping[str, str]) -> dict[str, Switch]:
        """Return mode to how it hears its command: dead zone, hysteresis, dead time.

        Args:
            units: role to unit of the logs that are looked at.

        Raises:
            SettingsError: a unit is of another dimension than the model's.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        found = {}
        for mode, channel in self.channels.items():
            benchmark = channel.benchmark
            share = benchmark.named_values().get("hysteresis", 0.0)
            zone = channel.dead_zone * self._command_factor(mode, units)
            found[mode] = Switch(zone, share * zone, float(benchmark.dead_time_s))
        return found

    def cut_at(self, units: Mapping[str, str]) -> dict[str, float]:
        """Return mode to the dead zone with which mixed cycles are cut into strokes.

        Args:
            units: role to unit of the logs that are cut.

        Raises:
            SettingsError: a unit is of another dimension than the model's.
        """
        checks.instance(units, Mapping, "units", "role to unit")
        zones = self.provenance.cut_at or self.dead_zones
        return {mode: zone * self._command_factor(mode, units) for mode, zone in zones.items()}

    def _command_factor(self, mode: str, units: Mapping[str, str]) -> float:
        role = COMMAND[mode]
        known = role in self.units and role in units
        return conversion_factor(self.units[role], units[role], role) if known else 1.0

    @double_precision
    def initial(self, displacement: float, load: float = 0.0) -> Packed:
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
            if not abs(numbers[-1]) < LARGEST:
                raise InputError(f"{name}: required a number within ±{LARGEST:g}, came {value}")
        return self._standing(*numbers)

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
            return self._step(state, self._given(commands, np.nan if measured is None else measured))

    def situation(self, state: Packed) -> State:
        """Return what a state says: displacement, channel in charge, what is missing.

        Raises:
            InputError: the state is none of this model.
        """
        with jax.enable_x64(True):
            self._check_state(state)
            return self._unpacked(state)

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
            SettingsError: a unit is of another dimension than the model's.
        """
        own = self.adopt(record)
        return self._given_back(self.free_run(own, compensated=compensated).displacement, own, record)

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
            SettingsError: a unit is of another dimension than the model's.
        """
        return self.predictions(record, (horizon,))[0]

    @double_precision
    def predictions(self, record: Record, horizons: Sequence[int], *, every: int = 1) -> np.ndarray:
        """Return `predict` for several horizons at once, shape [H, N].

        Args:
            record, horizons: as `predict` takes them.
            every: predict from one sample in so many; what is not predicted is NaN.
        """
        horizons = [checks.whole(each, "horizon", least=1) for each in horizons]
        if not horizons:
            raise InputError("horizons: required at least one number of samples, none came")
        checks.whole(every, "every", least=1)
        own = self.adopt(record)
        farthest = min(max(horizons), len(own))
        commands = padded(_commands(own), farthest)
        measured = padded(own.displacement, farthest)
        rest = self._rest(own)
        ahead = np.asarray(ahead_of(self._motion, jnp.array(rest), commands, measured, farthest, every))
        rows = [
            from_origins(ahead, rest.displacement, min(each, farthest), len(own), every) for each in horizons
        ]
        return np.stack([self._given_back(row, own, record) for row in rows])

    @double_precision
    def free_run(self, record: Record, *, compensated: bool = True) -> FreeRun:
        """Return the free run of an adopted record, and which channel is in charge.

        Args:
            record: on the model's clock and in its units; see `adopt`.
            compensated: False leaves the compensators out.
        """
        rest = self._rest(record)
        commands = padded(_commands(record), 1)
        displacement, charge = stepped(self._free_motion(compensated=compensated), jnp.array(rest), commands)
        count = len(record) - 1
        return FreeRun(
            _after(rest, np.asarray(displacement)[:count]),
            np.concatenate([np.asarray(charge)[:count], np.asarray(charge)[count - 1 : count]]),
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
            SettingsError: a unit is of another dimension than the model's.
        """
        checks.number(coverage, "coverage")
        known = self._bands
        lacking = [mode for mode in self.channels if mode not in known]
        if lacking:
            raise InputError(
                f"the model has no bands for {' and '.join(lacking)}; required at least three tests to "
                "identify it from"
            )
        own = self.adopt(record)
        run = self.free_run(own)
        if horizon is None:
            middle = self._given_back(run.displacement, own, record)
            half = self._free_run_half(own, run, known, coverage)
        else:
            checks.whole(horizon, "horizon", least=1)
            each = [known[mode].half_width(coverage, horizon) for mode in self.channels]
            middle = self.predict(record, horizon=horizon)
            half = np.where(run.charge < 0, max(each), np.array(each)[run.charge])
        half = self._given_back(half, own, record)
        return Band(middle - half, middle + half)

    @property
    def has_bands(self) -> bool:
        """Whether every channel has bands around its predictions."""
        return len(self._bands) == len(self.channels)

    @property
    def _bands(self) -> dict[str, Bands]:
        held = {mode: known.bands for mode, known in self.uncertainty.items() if mode in self.channels}
        return {mode: bands for mode, bands in held.items() if bands is not None}

    def _free_run_half(
        self, own: Record, run: FreeRun, bands: Mapping[str, Bands], coverage: float
    ) -> Float[np.ndarray, " n"]:
        floor = [ndtri(0.5 + coverage / 2) * each.noise for each in bands.values()]
        others, factors = [], []
        for mode, channel in self.channels.items():
            for each in bands[mode].alternatives:
                other = replace(self, channels={**self.channels, mode: possible(channel, each)})
                others.append(other._free_motion())
                factors.append(bands[mode].multiplier(coverage) * each.weight)
        rest = self._rest(own)
        runs = stepped_abreast(others, jnp.array(rest), padded(_commands(own), 1))[:, : len(own) - 1]
        apart = np.stack([_after(rest, row) for row in runs]) - run.displacement
        return np.sqrt(float(max(floor)) ** 2 + np.sum((np.array(factors)[:, None] * apart) ** 2, axis=0))

    def adopt(self, record: Record) -> Record:
        """Return a record on the model's clock and in the model's units.

        Raises:
            InputError: the record has no command for any channel, or one effective that no channel hears.
            SettingsError: a unit is of another dimension than the model's.
        """
        checks.instance(record, Record, "record", 'one of hitchid.read("logs").records')
        if not any(mode in record.modes for mode in self.channels):
            raise InputError(
                f"record '{record.name}' has commands for {' and '.join(record.modes)}; "
                f"the model has channels for {' and '.join(self.channels)}"
            )
        told = record.convert({role: unit for role, unit in self.units.items() if role in record.signals})
        on_clock = told if _same_clock(told.step_s, self.step_s, len(told)) else told.resample(self.step_s)
        scales = full_scales([record])
        for mode in record.modes:
            active = np.abs(record.command(mode)) > ACTIVE_FRACTION * scales[mode]
            if mode not in self.channels and np.any(active):
                raise InputError(
                    f"record '{record.name}': its {mode} command is not zero; the model has no {mode} channel"
                )
        return on_clock

    @cached_property
    def _motion(self) -> Motion:
        return Motion.of(tuple(self.channels.values()), self.step_s, self.drift)

    def _free_motion(self, *, compensated: bool = True) -> Motion:
        """Return the motion without what predicts from measurements, or without any compensator."""
        alone = {"compensator": None} if compensated else {"compensator": None, "speed_compensator": None}
        channels = [replace(channel, **alone) for channel in self.channels.values()]
        return Motion.of(channels, self.step_s, self.drift)

    def _check_state(self, state: Packed) -> None:
        """Refuse what is no state of this model; shapes alone are looked at, so that it may be traced."""
        required = "a state of this model, from `initial` or `step`"
        checks.instance(state, Packed, "state", required)
        if tuple(map(np.shape, state)) != self._state_shapes:
            raise checks.refusal("state", required, tuple(map(np.shape, state)))

    @cached_property
    def _packing(self) -> Packing:
        return Packing(jax.eval_shape(self._motion.standing))

    @cached_property
    def _standing(self) -> Callable[[float, float], Packed]:
        motion, packing = self._motion, self._packing
        return jax.jit(lambda displacement, load: packing.pack(motion.initial(displacement, load)))

    @cached_property
    def _unpacked(self) -> Callable[[Packed], State]:
        return jax.jit(self._packing.unpack)

    @cached_property
    def _step(self) -> Callable[..., tuple[Packed, Array]]:
        return self._packing.step(self._motion)

    @cached_property
    def _state_shapes(self) -> tuple[tuple[int, ...], ...]:
        return tuple(part.shape for part in jax.eval_shape(self._standing, 0.0, 0.0))

    def _given(self, commands: ArrayLike | Sequence[ArrayLike], measured: ArrayLike) -> Array | np.ndarray:
        """Return lifting and lowering command and measured displacement in one array, shape [3]."""
        parts = commands if isinstance(commands, Sequence) else (commands,)
        xp = jnp if any(isinstance(each, jax.Array) for each in (*parts, measured)) else np
        try:
            both, now = xp.asarray(commands), xp.asarray(measured)
        except (TypeError, ValueError) as error:
            raise checks.refusal("commands, measured", "numbers", (commands, measured)) from error
        if {both.dtype.kind, now.dtype.kind} - set("iuf"):
            raise checks.refusal("commands, measured", "numbers", (commands, measured))
        if both.shape == (1,) and len(self.channels) == 1:
            (mode,) = self.channels
            both = xp.zeros(len(MODES)) + both * np.array([each == mode for each in MODES])
        if both.shape != (len(MODES),):
            raise InputError(f"commands: required lifting and lowering, shape (2,), came shape {both.shape}")
        if now.shape != ():
            raise InputError(f"measured: required one displacement, shape (), came shape {now.shape}")
        return xp.append(both, now).astype(np.float64)

    def _rest(self, record: Record) -> Rest:
        """Return where a hitch stands before a record: the means before any command becomes effective."""
        effective = np.zeros(len(record))
        for mode, channel in self.channels.items():
            if mode in record.modes:
                effective += np.abs(effective_command(record.command(mode), channel.dead_zone))
        load = next((c.benchmark.load for c in self.channels.values() if c.benchmark.load), None)
        record.require(load)
        return Rest(
            mean_before_motion(record.displacement, effective),
            0.0 if load is None else mean_before_motion(record.signals[load], effective),
        )

    def _given_back(self, displacement: np.ndarray, own: Record, record: Record) -> np.ndarray:
        """Return a displacement on the model's clock and in its unit on the record's, in the record's."""
        unit = conversion_factor(self.units[DISPLACEMENT], record.unit, record.name)
        if own.step_s != record.step_s:
            displacement = np.interp(record.time_s, own.time_s, displacement)
        return displacement * unit


def _after(rest: Rest, displacement: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n1"]:
    """Return a free run from its first sample on."""
    return np.concatenate([[rest.displacement], displacement])


def _same_clock(step_s: float, wanted_s: float, samples: int) -> bool:
    return abs(step_s - wanted_s) * samples <= 0.05 * wanted_s


def _commands(record: Record) -> Float[np.ndarray, "n 2"]:
    """Return lifting and lowering command, zero where there is none, shape [N, 2]."""
    none = np.zeros(len(record))
    return np.stack([record.command(mode) if mode in record.modes else none for mode in MODES], axis=1)


def _widened(samples: np.ndarray, batch: Batch) -> np.ndarray:
    return np.pad(samples, (0, batch.command.shape[1] - samples.size), mode="edge")
