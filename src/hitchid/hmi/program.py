"""What a run is made of: a program says at each sample what is commanded, from what was measured."""

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hitchid.control import PositionController
from hitchid.errors import InputError
from hitchid.hmi.plans import MARGIN, Limits
from hitchid.hmi.source import CLOSED, is_same_sampling_time

MOVE_STROKES_PER_S = 0.15  # travels in a second, wanted speed between tests; chosen: a move takes 7 s
RISE_S = 4.0  # s, in which the command of a move rises from zero to its limit; chosen
STALLED_S = 1.0  # s without motion at the largest command after which a move ends, at a stop; chosen
COAST_S = 0.15  # s that the piston moves on after the command ends; chosen from the bench
SETTLE_S = 1.0  # s of rest before a test; chosen


class Step(NamedTuple):
    """What a program asks for until the next sample.

    Attributes:
        commands: lifting and lowering, shape [2].
        phase: positioning, settling, test or driving.
        log: name of the log that the sample belongs to; empty for none.
        left_s: rest of the phase, s; 0 where it is not known.
    """

    commands: np.ndarray
    phase: str
    log: str = ""
    left_s: float = 0.0


Program = Generator[Step, float, object]
"""Yields the step of a sample and is sent the displacement of the next one; NaN where there is none."""


def move(displacement: float, target: float, limits: Limits, step_s: float) -> Generator[Step, float, float]:
    """Yield the steps of a move to a target, and return the displacement reached.

    The command rises until the piston moves at the wanted speed, stays there, and ends where the piston will
    coast to the target, or at a stop. It is found anew in each move, so that nothing of the valves is known.
    """
    channel = 0 if target > displacement else 1
    direction = 1.0 if channel == 0 else -1.0
    largest, wanted = limits.commands[channel], MOVE_STROKES_PER_S * limits.travel
    command, stalled_s, speed = 0.0, 0.0, 0.0
    window = max(1, round(0.1 / step_s))  # samples of 0.1 s, over which the speed is taken
    history = [displacement] * window
    while direction * (target - displacement) > max(speed, 0.0) * COAST_S and stalled_s < STALLED_S:
        if speed < wanted:
            command = min(largest, command + largest * step_s / RISE_S)
        commands = CLOSED.copy()
        commands[channel] = command
        measured = yield Step(commands, "positioning")
        displacement = measured if np.isfinite(measured) else displacement
        history = [*history[1:], displacement]
        speed = direction * (history[-1] - history[0]) / (window * step_s)
        at_rest = speed < 0.02 * wanted
        stalled_s = stalled_s + step_s if at_rest and command == largest else 0.0
    for remaining in range(round(SETTLE_S / step_s), 0, -1):
        measured = yield Step(CLOSED, "settling", left_s=remaining * step_s)
        displacement = measured if np.isfinite(measured) else displacement
    return displacement


def apply(
    displacement: float,
    commands: np.ndarray,
    log: str,
    limits: Limits,
    step_s: float,
    travel: float = np.inf,
) -> Generator[Step, float, list[float]]:
    """Yield the steps of an open-loop test, and return the displacement at each of its samples.

    The commands are of shape [N, 2]. The test ends early where the piston comes near the end of its travel in
    the direction it is driven to, or has gone as far as `travel`.
    """
    low, high = limits.displacement
    near_end, measured = MARGIN * limits.travel, [displacement]
    for sample, row in enumerate(commands):
        displacement = yield Step(row, "test", log, (len(commands) - sample) * step_s)
        measured.append(displacement)
        is_up, is_down = row[0] > 0, row[1] > 0
        if (is_up and displacement > high - near_end) or (is_down and displacement < low + near_end):
            break
        if abs(displacement - measured[0]) > travel:
            break
    return measured[:-1]


# Program of a closed loop: a tuned controller, whose target the operator moves.


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
    controller: PositionController, log: str, displacement: float, target: Target, limits: Limits
) -> Program:
    """Return the program of a closed loop, compiled; it ends only when it is stopped.

    The target is read at each sample, and kept inside the travel.
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
