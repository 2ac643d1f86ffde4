"""Program of a closed loop: a tuned controller, whose target the operator moves."""

import dataclasses
from pathlib import Path

import numpy as np

from hitchid.control import load_controller
from hitchid.hmi.limits import Limits
from hitchid.hmi.program import Program, Step


@dataclasses.dataclass
class Target:
    """Where the hitch shall be, in the displacement's unit; set while a loop runs."""

    displacement: float


def drive(path: Path, log: str, displacement: float, target: Target, limits: Limits) -> Program:
    """Return the program of a closed loop, compiled; it ends only when it is stopped.

    Args:
        path: controller file.
        log: name of its log.
        displacement: now.
        target: read at each sample.
        limits: of travel; the target is kept inside.

    Raises:
        SettingsError: the controller file cannot be used.
    """
    controller = load_controller(path).controller
    initial = controller.initial_state(displacement)
    controller.step(initial, displacement, displacement)

    def run() -> Program:
        state, measured = initial, displacement
        while True:
            wanted = float(np.clip(target.displacement, *limits.displacement))
            state, currents = controller.step(state, wanted, measured)
            measured = yield Step(np.asarray(currents), "driving", log)

    return run()
