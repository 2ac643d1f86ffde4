"""A log as a source: its samples as they were recorded."""

import math
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from hitchid.bench import load_rig
from hitchid.bench.simulation import SAMPLE_S
from hitchid.bench.stepping import reset, step
from hitchid.errors import InputError
from hitchid.hmi.source import DISPLACEMENT, LIFTING_COMMAND, LOWERING_COMMAND, Reading, Signal
from hitchid.logs import read
from hitchid.logs.record import COMMAND, DIRECTIONS

# The virtual bench as a source.

START_M = 0.02  # m, displacement at which the bench is switched on: just above the lower stop; chosen
PA_PER_BAR = 1e5


class VirtualBench:
    """The virtual bench: currents in, displacement, currents and pressures out, 10 ms a sample.

    Args:
        rig: name or file of a parameter set.
        seed: of the noise of its sensors.
    """

    label = "virtual bench"
    signals = (
        Signal(LIFTING_COMMAND, "Lifting command", "A", "command"),
        Signal(LOWERING_COMMAND, "Lowering command", "A", "command"),
        Signal(DISPLACEMENT, "Displacement", "mm", "displacement"),
        Signal("lifting_current", "Lifting current", "A", "command"),
        Signal("lowering_current", "Lowering current", "A", "command"),
        Signal("cylinder_pressure", "Cylinder pressure", "bar", "pressure"),
        Signal("supply_pressure", "Supply pressure", "bar", "pressure"),
    )
    step_s = SAMPLE_S
    virtual = True
    can_move = True

    def __init__(self, rig: str = "nominal", seed: int = 0) -> None:
        self._rig, self._seed = load_rig(rig), seed
        self.label = f"virtual bench, {rig}"

    def open(self) -> None:
        """Switch the bench on, and compile its step."""
        self._state, self._measurement = reset(
            self._rig, jax.random.key(self._seed), initial_displacement_m=START_M
        )
        step(self._rig, self._state, np.zeros(2))

    def read(self) -> Sequence[Reading]:
        """Return the present sample."""
        plant = self._state.plant
        pressures = (plant.pressure, plant.supply_pressure)
        (time_s, displacement, (up, down)), (pressure, supply) = jax.device_get(
            (self._measurement, pressures)
        )
        row = (math.nan, math.nan, displacement, up, down, pressure / PA_PER_BAR, supply / PA_PER_BAR)
        return (Reading(float(time_s), tuple(map(float, row))),)

    def write(self, commands: np.ndarray) -> None:
        """Advance the bench by one sample."""
        self._state, self._measurement = step(self._rig, self._state, commands)

    def close(self) -> None:
        """Do nothing: the bench ends with its process."""


GROUPS = {"bar": "pressure", "Pa": "pressure", "kPa": "pressure", "MPa": "pressure"}


class Replay:
    """A log, sample by sample on its own clock; it moves nothing and ends with the log.

    Args:
        log: file; a `campaign.toml` beside it assigns its signals.
    """

    virtual = True
    can_move = False

    def __init__(self, log: str) -> None:
        records = read(log).records
        if not records:
            raise InputError(f"{log}: holds no record that can be replayed")
        record = records[0]
        columns = {}
        for name, direction in zip((LIFTING_COMMAND, LOWERING_COMMAND), DIRECTIONS, strict=True):
            given = direction in record.directions
            unit = record.units[COMMAND[direction]] if given else "A"
            signal = Signal(name, f"{direction.capitalize()} command", unit, "command")
            columns[signal] = record.command(direction) if given else np.zeros(len(record))
        columns[Signal(DISPLACEMENT, "Displacement", record.unit, "displacement")] = record.displacement
        for name, values in record.signals.items():
            if name != "displacement" and name not in COMMAND.values():
                unit = record.units[name]
                label = name.replace("_", " ").capitalize()
                columns[Signal(name, label, unit, GROUPS.get(unit, "other"))] = values
        self.label = f"replay of {Path(log).name}"
        self.signals = tuple(columns)
        self.step_s = record.step_s
        self._rows = np.column_stack(list(columns.values()))

    def open(self) -> None:
        """Start at the first sample."""
        self._sample = 0

    def read(self) -> Sequence[Reading]:
        """Return the next sample.

        Raises:
            InputError: the log has ended.
        """
        if self._sample == len(self._rows):
            raise InputError("the log has ended; connect again to replay it once more")
        row = self._rows[self._sample]
        self._sample += 1
        return (Reading(self.step_s * (self._sample - 1), tuple(map(float, row))),)

    def write(self, commands: np.ndarray) -> None:
        """Do nothing: a log takes no commands."""

    def close(self) -> None:
        """Do nothing: the log is in memory."""
