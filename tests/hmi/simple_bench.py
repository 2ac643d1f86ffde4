"""A source without JAX: a cylinder whose speed is proportional to what exceeds the dead zone."""

import math

import numpy as np

from hitchid.hmi import Reading, Signal

DEAD_ZONE_A, SPEED = 0.3, 150.0  # A, mm/(s A)


class SimpleBench:
    """A virtual cylinder of 250 mm."""

    label = "simple bench"
    signals = (
        Signal("lifting_command", "Lifting command", "A", "command"),
        Signal("lowering_command", "Lowering command", "A", "command"),
        Signal("displacement", "Displacement", "mm", "displacement"),
        Signal("pressure", "Pressure", "bar", "pressure"),
    )
    step_s = 0.01
    virtual = True
    can_move = True

    def open(self):
        self.sample, self.displacement = 0, 100.0

    def read(self):
        return [Reading(self.step_s * self.sample, (math.nan, math.nan, self.displacement, 80.0))]

    def write(self, commands):
        self.sample += 1
        up, down = np.maximum(np.asarray(commands) - DEAD_ZONE_A, 0.0)
        moved = self.displacement + self.step_s * SPEED * (up - down)
        self.displacement = float(np.clip(moved, 0.0, 250.0))

    def close(self):
        pass
