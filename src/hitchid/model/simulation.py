"""Simulation from commands and an initial displacement alone, without a measurement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import DTypeLike

from hitchid._support import checks
from hitchid._support.bounded import MAX_MAGNITUDE
from hitchid._support.precision import double_precision
from hitchid._support.screen import GAP, screen, wrapped
from hitchid._support.tables import dataframe
from hitchid.errors import InputError
from hitchid.logs.kinds import ACTIVE_FRACTION, effective_command, full_scales
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT, Record, held_rows
from hitchid.logs.units import conversion_factor
from hitchid.model.bands import Band, Bands, bands_by_channel
from hitchid.model.channel import Channel
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.free_run import (
    FreeRun,
    FreeRunInputs,
    InitialCondition,
    commands_of,
    free_run,
    hitch_half_width,
)
from hitchid.model.inputs import (
    Commands,
    Load,
    Numbers,
    channel_load,
    covariates_of,
    loads_by_name,
    record_of_commands,
    stacked,
)
from hitchid.structures import mean_before_motion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


# Conversion of records to a model's clock and units, and of displacements back.

MAX_CLOCK_SHIFT = 0.05  # share of a sampling time that two clocks may differ over a whole record; chosen


def to_model_units(
    record: Record, directions: Sequence[str], units: Mapping[str, str], step_s: float
) -> Record:
    """Return a record on a model's clock and in its units; see `Hitch.to_model_units`."""
    checks.instance(record, Record, "record", 'one of hitchid.read("logs").records')
    if not any(direction in record.directions for direction in directions):
        raise InputError(
            f"record '{record.name}' has commands for {' and '.join(record.directions)}; "
            f"the model has channels for {' and '.join(directions)}"
        )
    converted = record.convert({role: unit for role, unit in units.items() if role in record.signals})
    # Clocks that hardly part are taken for one: interpolation would smooth what was measured.
    shift_s = abs(converted.step_s - step_s) * len(converted)
    resampled = converted if shift_s <= MAX_CLOCK_SHIFT * step_s else converted.resample(step_s)
    # A command without a channel may be logged, but must not be effective.
    scales = full_scales([record])
    for direction in record.directions:
        active = np.abs(record.command(direction)) > ACTIVE_FRACTION * scales[direction]
        if direction not in directions and np.any(active):
            raise InputError(
                f"record '{record.name}': its {direction} command is not zero; the model has no {direction} "
                "channel"
            )
    return resampled


def to_record_units(
    displacement: Float[np.ndarray, "*m n"],
    units: Mapping[str, str],
    model_record: Record,
    record: Record,
) -> np.ndarray:
    """Return a displacement of the model on the record's clock and in its unit."""
    factor = conversion_factor(units[DISPLACEMENT], record.unit, record.name)
    return factor * interpolated(displacement, model_record.time_s, record.time_s)


def interpolated(
    samples: Float[np.ndarray, "*m n"], old_times_s: np.ndarray, new_times_s: np.ndarray
) -> np.ndarray:
    """Return samples interpolated from one clock to another, linearly; exact for equal clocks."""
    return np.apply_along_axis(lambda row: np.interp(new_times_s, old_times_s, row), -1, samples)


def condition_before_motion(
    record: Record,
    channels: Mapping[str, Channel],
    *,
    displacement: np.ndarray | None = None,
    load: Mapping[str, np.ndarray] | None = None,
) -> InitialCondition:
    """Return displacement and covariates before motion, of a record on the model's clock and in its units.

    A displacement that is not given is the mean before any command is effective; covariates that are not
    given are those of the record.

    Raises:
        InputError: the record lacks a covariate, or given values differ in number.
    """
    effective = np.zeros(len(record))
    for direction, channel in channels.items():
        if direction in record.directions:
            effective += np.abs(effective_command(record.command(direction), channel.dead_zone))
    if displacement is None:
        displacement = np.asarray(mean_before_motion(record.displacement, effective))
    given = load or {}
    names = covariates_of(channels.values())
    signals = record.require([name for name in names if name not in given]).signals
    rows = stacked(
        [given[name] if name in given else mean_before_motion(signals[name], effective) for name in names]
    )
    try:
        runs = np.broadcast_shapes(displacement.shape, rows.shape[:-1])
    except ValueError as error:
        count = rows[..., 0].size
        raise InputError(
            f"initial and load: expected equal numbers of values, got {displacement.size} and {count}"
        ) from error
    return InitialCondition(
        np.broadcast_to(displacement, runs), np.broadcast_to(rows, (*runs, rows.shape[-1]))
    )


# Where a free run is outside the operating range of the identification tests.


def out_of_range(
    channels: Sequence[Channel], units: Mapping[str, str], inputs: FreeRunInputs, run: FreeRun
) -> dict[str, Bool[np.ndarray, "*m n"]]:
    """Return signals outside their range while their channel is in charge, and limits that clip the run.

    Returns:
        A sentence that names the signal, its range and the number of samples, to which samples they are.
    """
    displacement, active_channel, _ = run
    runs = f" of {len(displacement)} runs" if displacement.ndim > 1 else ""
    of_all = f"of {displacement.size} samples{runs}"
    outside = {}
    for number, channel in enumerate(channels):
        covered, command = channel.operating_range, inputs.commands[:, DIRECTIONS.index(channel.direction)]
        effective = np.abs(effective_command(command, channel.dead_zone))
        load = channel_load(channels, number, jnp.asarray(inputs.initial.load))
        trusts = {
            "command": covered.command.trust(jnp.asarray(effective)),
            "displacement": covered.displacement.trust(jnp.asarray(displacement)),
            "load": covered.load_trust(load)[..., None],
        }
        for name, trust in trusts.items():
            samples = (np.asarray(trust) < 1) & (active_channel == number)
            described = describe_range(channel, units, name)
            sentence = (
                f"{channel.direction}: the {name} is outside the identified range, {described}, "
                f"in {samples.sum()} {of_all}"
            )
            outside[sentence] = samples
    limits = channels[0].limits
    if limits is not None:
        samples = limits.at_soft_limit(displacement)
        sentence = f"{limits.sentence(units[DISPLACEMENT])}; this limit applies in {samples.sum()} {of_all}"
        outside[sentence] = samples
    return {sentence: samples for sentence, samples in outside.items() if samples.any()}


def describe_range(channel: Channel, units: Mapping[str, str], name: str) -> str:
    """Return the range of `command`, `displacement` or `load` in the identification tests as text."""
    signal_range = getattr(channel.operating_range, name)
    if name == "load":
        covariates = channel.benchmark.covariates
        ends = zip(signal_range.lowest.tolist(), signal_range.highest.tolist(), strict=True)
        ranges = [f"{low:.4g} to {high:.4g}" for low, high in ends]
        if len(ranges) == 1:
            return f"{ranges[0]} {units.get(''.join(covariates), '')}".rstrip()
        named = zip(covariates, ranges, strict=True)
        return ", ".join(f"{covariate} {text} {units.get(covariate, '')}" for covariate, text in named)
    role = {"command": COMMAND[channel.direction], "displacement": DISPLACEMENT}[name]
    suffix = " beyond the dead zone" if name == "command" else ""
    ends = f"{float(signal_range.lowest):.4g} to {float(signal_range.highest):.4g}"
    return f"{ends} {units.get(role, '')}{suffix}"


HOLD = "hold"  # `Simulation.mode` while no command demands motion


class SimulatedModel(NamedTuple):
    """The part of a model that determines free runs and their bands.

    Attributes:
        dynamics: dynamics in free run.
        units: role to unit.
        bands: direction to the bands of its channel; empty where there are none.
    """

    dynamics: HitchDynamics
    units: Mapping[str, str]
    bands: Mapping[str, Bands]


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """Free run: displacement from commands and an initial displacement alone.

    NumPy takes it as the array of its displacement, as in `record.displacement - simulation`.

    Attributes:
        time_s: time of each sample, s, shape [N].
        displacement: in `unit`, shape [N], or [M, N] for M initial displacements or loads.
        unit: unit of the displacement.
        run: free run on the model's clock and in its units.
        inputs: commands and initial condition, on the model's clock and in its units.
        model_time_s: time of each sample on the model's clock, s.
        model: the simulated model.
    """

    time_s: np.ndarray
    displacement: np.ndarray
    unit: str
    run: FreeRun
    inputs: FreeRunInputs
    model_time_s: np.ndarray
    model: SimulatedModel

    @property
    def mode(self) -> np.ndarray:
        """State from each sample to the next, text, of the displacement's shape.

        `lifting` or `lowering` while a command of the direction in charge demands motion, else `hold`.
        """
        # `HOLD` comes last, where −1 finds it.
        names = np.array([*(channel.direction for channel in self.model.dynamics.channels), HOLD])
        return self._held(names[np.where(self.run.is_held, -1, self.run.active_channel)])

    @property
    def flags(self) -> tuple[str, ...]:
        """A sentence for each signal outside the operating range of the identification tests.

        More than a tenth of a range outside, the simulation is that of the benchmark without compensator.
        """
        return tuple(self._out_of_range)

    @property
    def out_of_range(self) -> np.ndarray:
        """Which samples have a signal outside its range, see `flags`; of the displacement's shape."""
        masks = [np.zeros_like(self.run.is_held), *self._out_of_range.values()]
        return self._held(np.any(masks, axis=0))

    @double_precision
    def band(self, coverage: float = 0.9) -> Band:
        """Return the band that contains the measured displacement for a share of the samples of a test.

        The half width is √(z² n² + Σ q² w² (y_a − y)²), the sum over the ensembles of all channels; see
        `Bands`. Each member of the ensembles is simulated, so that this takes longer than the simulation.

        Args:
            coverage: share of samples, 0.5 to 0.95.

        Raises:
            InputError: the model has no bands or none for this coverage.
        """
        checks.number(coverage, "coverage")
        dynamics, units, all_bands = self.model
        bands = bands_by_channel(all_bands, [channel.direction for channel in dynamics.channels])
        half_width = hitch_half_width(dynamics, bands, self.inputs, self.run, coverage)
        factor = conversion_factor(units[DISPLACEMENT], self.unit, DISPLACEMENT)
        half_width = factor * interpolated(half_width, self.model_time_s, self.time_s)
        return Band(self.displacement - half_width, self.displacement + half_width)

    def plot(self, axes: "Sequence[Axes] | np.ndarray | None" = None) -> np.ndarray:
        """Draw displacement above and commands below, over time; of several runs the first eight.

        Args:
            axes: two matplotlib axes to draw into; None for a new figure of pyplot.

        Returns:
            The two axes.

        Raises:
            InputError: other than two axes are given.
        """
        from hitchid.model.plotting import plot_simulation

        return plot_simulation(self, axes)

    def to_dataframe(self) -> "DataFrame":
        """Return time, displacement, mode and `out_of_range`, one row a sample.

        The column `run` numbers the runs if there are several.

        Raises:
            InputError: pandas is not installed.
        """
        shape = self.displacement.shape
        columns = {"run": np.broadcast_to(np.arange(shape[0])[:, None], shape)} if len(shape) > 1 else {}
        columns |= {
            "time_s": np.broadcast_to(self.time_s, shape),
            f"displacement_{self.unit}": self.displacement,
            "mode": self.mode,
            "out_of_range": self.out_of_range,
        }
        return dataframe({name: np.ravel(values) for name, values in columns.items()})

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        """Return the displacement."""
        return np.array(self.displacement, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        """Return number of samples, range of time and displacement, and the flags."""
        *runs, samples = self.displacement.shape
        lowest, highest = np.min(self.displacement), np.max(self.displacement)
        sentence = (
            f"Simulation: {f'{runs[0]} runs of ' if runs else ''}{samples} samples, "
            f"{self.time_s[0]:.4g} to {self.time_s[-1]:.4g} s, "
            f"displacement {lowest:.4g} to {highest:.4g} {self.unit}"
        )
        return screen([sentence, *(line for flag in self.flags for line in wrapped(GAP, flag))])

    @cached_property
    @double_precision
    def _out_of_range(self) -> dict[str, np.ndarray]:
        return out_of_range(self.model.dynamics.channels, self.model.units, self.inputs, self.run)

    def _held(self, values: np.ndarray) -> np.ndarray:
        """Return values at the samples of `time_s`: the last value on the model's clock."""
        return values[..., held_rows(self.model_time_s, self.time_s)]


def simulate(
    model: SimulatedModel,
    commands: Record | Commands,
    *,
    step_s: float | None,
    initial: Numbers | None,
    load: Load | None,
) -> Simulation:
    """Return the free run of a record or of commands alone; see `Hitch.simulate`."""
    channels = {channel.direction: channel for channel in model.dynamics.channels}
    covariates = covariates_of(channels.values())
    given = loads_by_name(load, covariates, "model")
    loads = {name: _checked(values, "load") for name, values in given.items()}
    if not isinstance(commands, Record):
        if initial is None:
            unit = model.units[DISPLACEMENT]
            raise InputError(f"initial: expected the initial displacement, in {unit}, got None")
        for name in covariates:
            if name not in loads:
                raise InputError(
                    f"load: expected '{name}' before motion, in {model.units[name]}, which the model "
                    f"requires; got {load}"
                )
        # What is missing is named before the commands are looked at: of both the user is told the simpler.
        record = record_of_commands(commands, tuple(channels), model.units, step_s)
    elif step_s is not None:
        raise InputError(f"step_s: a record has its own sampling time; expected None, got {step_s}")
    else:
        record = commands
        for name in covariates:
            if name not in loads and name not in record.signals:
                raise InputError(
                    f"record '{record.name}' has no '{name}', which the model requires; expected this "
                    f"signal in the record, or `load`, its value before motion, in {model.units[name]}"
                )
    model_record = to_model_units(record, tuple(channels), model.units, model.dynamics.step_s)
    # The dynamics would take so large a command as missing, and keep the last one.
    for direction in model_record.directions:
        command = np.abs(model_record.command(direction))
        if not np.all(command < MAX_MAGNITUDE):
            sample = int(np.argmax(command))
            raise InputError(
                f"commands: expected values within ±{MAX_MAGNITUDE:g}, got {command[sample]:g} at sample "
                f"{sample} ({direction})"
            )
    initial_condition = condition_before_motion(
        model_record,
        channels,
        displacement=None if initial is None else _checked(initial, "initial"),
        load=loads,
    )
    inputs = FreeRunInputs(commands_of(model_record), initial_condition)
    run = free_run(model.dynamics, inputs)
    displacement = to_record_units(run.displacement, model.units, model_record, record)
    return Simulation(record.time_s, displacement, record.unit, run, inputs, model_record.time_s, model)


def _checked(values: Numbers, name: str) -> np.ndarray:
    """Return one or several finite numbers as an array of shape [] or [M]."""
    required = f"one or several numbers within ±{MAX_MAGNITUDE:g}"
    array = checks.array(values, name, required)
    if array.ndim > 1 or not array.size or not np.all(np.abs(array) < MAX_MAGNITUDE):
        raise checks.input_error(name, required, values)
    return array.astype(np.float64)
