"""Program of a closed loop: a tuned controller, whose target the operator moves."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hitchid.control import PositionController
from hitchid.errors import InputError
from hitchid.hmi.limits import Limits
from hitchid.hmi.program import Program, Step
from hitchid.hmi.source import is_same_sampling_time


@dataclass
class Target:
    """Where the hitch shall be, in the displacement's unit; set while a loop runs."""

    displacement: float


def check_clock_and_units(
    controller_step_s: float, controller_units: Mapping[str, str], step_s: float, units: Mapping[str, str]
) -> None:
    """Check that a controller fits the sampling time, s, and the units of a source.

    Raises:
        InputError: the source has another sampling time, or other units.
    """
    if not is_same_sampling_time(step_s, controller_step_s):
        raise InputError(
            f"controller: has a sampling time of {controller_step_s:g} s, the source of {step_s:g} s; "
            "tune a controller for that of the source"
        )
    for name, unit in controller_units.items():
        if units[name] != unit:
            raise InputError(f"controller: expected {name} in {unit}, the source has {units[name]}")


def drive(
    controller: PositionController,
    log: str,
    displacement: float,
    target: Target,
    limits: Limits,
) -> Program:
    """Return the program of a closed loop, compiled; it ends only when it is stopped.

    Args:
        controller: tuned.
        log: name of its log.
        displacement: now.
        target: read at each sample.
        limits: of travel; the target is kept inside.
    """
    initial = controller.initial_state(displacement)
    stepped, _ = controller.step(initial, displacement, displacement)
    controller.step(stepped, displacement, displacement)  # a state that was stepped may compile anew

    def run() -> Program:
        state, measured = initial, displacement
        while True:
            wanted = float(np.clip(target.displacement, *limits.displacement))
            state, currents = controller.step(state, wanted, measured)
            measured = yield Step(np.asarray(currents), "driving", log)

    return run()
