"""The virtual bench and logs as sources."""

import math
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from hitchid.bench import Rig, load_rig
from hitchid.bench.simulation import SAMPLE_S
from hitchid.bench.stepping import reset, step
from hitchid.errors import InputError
from hitchid.hmi.source import DISPLACEMENT, REQUIRED, REQUIRED_SIGNALS, Reading, signal_named
from hitchid.logs import COMMAND, DIRECTIONS, read

START_M = 0.02  # m, displacement at which the bench is switched on: just above the lower stop; chosen
PA_PER_BAR = 1e5


class VirtualBench:
    """The virtual bench of a parameter set: currents in, displacement, currents and pressures out."""

    label = "virtual bench"
    signals = (
        *REQUIRED_SIGNALS,
        signal_named("lifting_current", "A", "command"),
        signal_named("lowering_current", "A", "command"),
        signal_named("cylinder_pressure", "bar", "pressure"),
        signal_named("supply_pressure", "bar", "pressure"),
    )
    step_s = SAMPLE_S
    virtual = True
    can_move = True

    def __init__(self, rig: str | Rig, seed: int = 0) -> None:
        self._rig, self._seed = (load_rig(rig) if isinstance(rig, str) else rig), seed
        self.label = f"virtual bench, {rig}" if isinstance(rig, str) else "virtual bench"

    def open(self) -> None:
        """Switch the bench on, and compile its step."""
        key = jax.random.key(self._seed)
        self._state, self._measurement = reset(self._rig, key, initial_displacement_m=START_M)
        step(self._rig, self._state, np.zeros(2))  # compiled here: no tick should wait for it

    def read(self) -> Sequence[Reading]:
        """Return the present sample."""
        plant = self._state.plant
        pressures = (plant.pressure, plant.supply_pressure)
        # At once: one transfer from the device instead of one for each value.
        (time_s, displacement, (up, down)), (pressure, supply) = jax.device_get(
            (self._measurement, pressures)
        )
        # Commands without a value are filled in by the loop; the currents beside them are measured.
        row = (math.nan, math.nan, displacement, up, down, pressure / PA_PER_BAR, supply / PA_PER_BAR)
        return (Reading(float(time_s), tuple(map(float, row))),)

    def write(self, commands: np.ndarray) -> None:
        """Advance the bench by one sample."""
        self._state, self._measurement = step(self._rig, self._state, commands)

    def close(self) -> None:
        """Do nothing: the bench ends with its process."""


GROUPS = {"bar": "pressure", "Pa": "pressure", "kPa": "pressure", "MPa": "pressure"}


class Replay:
    """A log, sample by sample on its own clock; a `campaign.toml` beside it assigns its signals."""

    virtual = True
    can_move = False

    def __init__(self, log: str) -> None:
        records = read(log).records
        if not records:
            raise InputError(f"{log}: holds no record that can be replayed")
        record = records[0]
        columns = {}
        for name, direction in zip(REQUIRED[:2], DIRECTIONS, strict=True):
            given = direction in record.directions
            unit = record.units[COMMAND[direction]] if given else "A"
            # A log of one direction has both commands here: every source has the same first signals.
            columns[signal_named(name, unit, "command")] = (
                record.command(direction) if given else np.zeros(len(record))
            )
        columns[signal_named(DISPLACEMENT, record.unit, "displacement")] = record.displacement
        for name, values in record.signals.items():
            if name != DISPLACEMENT and name not in COMMAND.values():
                unit = record.units[name]
                columns[signal_named(name, unit, GROUPS.get(unit, "other"))] = values
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
