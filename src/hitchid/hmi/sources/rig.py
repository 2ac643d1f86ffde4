"""The virtual bench as a source."""

import math
from collections.abc import Sequence

import jax
import numpy as np

from hitchid.hmi.source import DISPLACEMENT, LIFTING_COMMAND, LOWERING_COMMAND, Reading, Signal
from hitchid.rig import load_rig
from hitchid.rig.simulation import SAMPLE_S
from hitchid.rig.stepping import reset, step

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
