"""Simulation from commands and an initial displacement alone, without a measurement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from hitchid._support import checks
from hitchid._support.dataframes import dataframe
from hitchid._support.precision import double_precision
from hitchid._support.summary import GAP, screen, wrapped
from hitchid.data.record import DISPLACEMENT, Record, held_rows
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model import conversion
from hitchid.model.bands import Band, Bands, bands_by_channel
from hitchid.model.commands import Commands, Numbers, record_of_commands
from hitchid.model.dynamics import MAX_MAGNITUDE, HitchDynamics
from hitchid.model.ensemble import hitch_half_width
from hitchid.model.extrapolation import OutOfRange, out_of_range
from hitchid.model.free_run import FreeRun, FreeRunInputs, commands_of, free_run
from hitchid.model.loads import Load, covariates_of, loads_by_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

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
        names = np.array([*(channel.direction for channel in self.model.dynamics.channels), HOLD])
        return self._held(names[np.where(self.run.is_held, -1, self.run.active_channel)])

    @property
    def flags(self) -> tuple[str, ...]:
        """A sentence for each signal outside the operating range of the identification tests.

        More than a tenth of a range outside, the simulation is that of the benchmark without compensator.
        """
        return tuple(signal.sentence for signal in self._out_of_range)

    @property
    def out_of_range(self) -> np.ndarray:
        """Which samples have a signal outside its range, see `flags`; of the displacement's shape."""
        masks = [signal.samples for signal in self._out_of_range]
        return self._held(np.any([np.zeros_like(self.run.is_held), *masks], axis=0))

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
        half_width = factor * conversion.interpolated(half_width, self.model_time_s, self.time_s)
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
    def _out_of_range(self) -> tuple[OutOfRange, ...]:
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
    model_record = conversion.to_model_units(record, tuple(channels), model.units, model.dynamics.step_s)
    _check_magnitude(model_record)
    initial_condition = conversion.initial_condition(
        model_record,
        channels,
        displacement=None if initial is None else _checked(initial, "initial"),
        load=loads,
    )
    inputs = FreeRunInputs(commands_of(model_record), initial_condition)
    run = free_run(model.dynamics, inputs)
    displacement = conversion.to_record_units(run.displacement, model.units, model_record, record)
    return Simulation(record.time_s, displacement, record.unit, run, inputs, model_record.time_s, model)


def _check_magnitude(record: Record) -> None:
    """Raise InputError for a command so large that the dynamics take it as missing."""
    for direction in record.directions:
        command = np.abs(record.command(direction))
        if not np.all(command < MAX_MAGNITUDE):
            sample = int(np.argmax(command))
            raise InputError(
                f"commands: expected values within ±{MAX_MAGNITUDE:g}, got {command[sample]:g} at sample "
                f"{sample} ({direction})"
            )


def _checked(values: Numbers, name: str) -> np.ndarray:
    """Return one or several finite numbers as an array of shape [] or [M]."""
    required = f"one or several numbers within ±{MAX_MAGNITUDE:g}"
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise checks.input_error(name, required, values) from error
    if array.dtype.kind not in "iuf" or array.ndim > 1 or not array.size:
        raise checks.input_error(name, required, values)
    if not np.all(np.abs(array) < MAX_MAGNITUDE):
        raise checks.input_error(name, required, values)
    return array.astype(np.float64)
