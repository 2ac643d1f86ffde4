"""Programs: a program says at each sample what is commanded, from what was measured."""

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hitchid.bench.excitation import (
    StaticResult,
    binary_command,
    cycle_commands,
    evaluate_ramps,
    two_channel_command,
)
from hitchid.control import PositionController
from hitchid.errors import InputError, LogError
from hitchid.hmi.plans import MARGIN, CampaignPlan, Limits
from hitchid.hmi.source import CLOSED, Signal, is_same_sampling_time
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, RAMP, Record

MOVE_STROKES_PER_S = 0.15  # travels in a second, wanted speed between tests; chosen: a move takes 7 s
RISE_S = 4.0  # s, in which the command of a move rises from zero to its limit; chosen
STALLED_S = 1.0  # s without motion at the largest command after which a move ends, at a stop; chosen
COAST_S = 0.15  # s that the piston moves on after the command ends; chosen from the bench
SETTLE_S = 1.0  # s of rest before a test; chosen
SPEED_WINDOW_S = 0.1  # s, over which a speed is taken; chosen
NEAR_ONSET = 0.8  # of a command that is known to move the piston, at which a move begins; chosen


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


def move(
    displacement: float,
    target: float,
    limits: Limits,
    step_s: float,
    *,
    signs: tuple[int, int] = (1, -1),
    onsets: tuple[float, float] = (0.0, 0.0),
    window_s: float = SPEED_WINDOW_S,
    log: str = "",
) -> Generator[Step, float, float]:
    """Yield the steps of a move to a target, and return the displacement reached.

    The command rises until the piston moves at the wanted speed, stays there, and ends where the piston will
    coast to the target, or at a stop. It is found anew in each move, so that nothing of the valves need be
    known; where the commands at which they open are, it begins there.

    Args:
        displacement, target: where it begins and ends.
        limits: of the machine.
        step_s: between two samples, s.
        signs: +1 where the displacement grows with the command, −1 where it falls; lifting, lowering.
        onsets: commands from which the piston moves, zero where they are not known.
        window_s: over which the speed is taken, s.
        log: name of its log; empty for none.
    """
    direction = 1.0 if target > displacement else -1.0
    channel = signs.index(int(direction))
    largest, wanted = limits.commands[channel], MOVE_STROKES_PER_S * limits.travel
    command, stalled_s, speed = NEAR_ONSET * onsets[channel], 0.0, 0.0
    window = max(1, round(window_s / step_s))
    history = [displacement] * window
    # It ends before the target by what the piston still coasts: braking is up to the closed valve alone.
    while direction * (target - displacement) > max(speed, 0.0) * COAST_S and stalled_s < STALLED_S:
        if speed < wanted:  # from then on the command stays: it is the one that gives this speed here
            command = min(largest, command + largest * step_s / RISE_S)
        commands = CLOSED.copy()
        commands[channel] = command
        measured = yield Step(commands, "positioning", log)
        # A sample without a displacement is bridged here; how many may lack one is up to the bench loop.
        displacement = measured if np.isfinite(measured) else displacement
        history = [*history[1:], displacement]
        speed = direction * (history[-1] - history[0]) / (window * step_s)
        at_rest = speed < 0.02 * wanted
        # Only at the largest command: below it the piston may rest because the valve has not opened yet.
        stalled_s = stalled_s + step_s if at_rest and command == largest else 0.0
    return (yield from settle(displacement, step_s))


def settle(displacement: float, step_s: float) -> Generator[Step, float, float]:
    """Yield the steps of a rest before a test, and return the displacement there."""
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
        # By the direction driven: a test that begins at an end of travel must be able to leave it.
        is_up, is_down = row[0] > 0, row[1] > 0
        if (is_up and displacement > high - near_end) or (is_down and displacement < low + near_end):
            break
        if abs(displacement - measured[0]) > travel:
            break
    return measured[:-1]  # the last one was measured after the last command, which is no sample of the log


@dataclass
class Machine:
    """What a plan needs to know of the machine.

    Attributes:
        signals: of its source.
        step_s: between two ticks, s.
        interval_s: between two samples, s; longer where a source delivers more slowly than it is asked.
        limits: of commands and travel.
        is_virtual: whether it is no real machine.
    """

    signals: tuple[Signal, ...]
    step_s: float
    interval_s: float
    limits: Limits
    is_virtual: bool = True


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
    # Compiled here, while armed with closed valves: in the loop it would delay a tick by seconds.
    initial = controller.initial_state(displacement)
    stepped, _ = controller.step(initial, displacement, displacement)
    controller.step(stepped, displacement, displacement)  # a state that was stepped may compile anew

    def run() -> Program:
        state, measured = initial, displacement
        while True:
            # A target beyond would drive the piston against its stop until the loop stops the run.
            wanted = float(np.clip(target.displacement, *limits.displacement))
            state, currents = controller.step(state, wanted, measured)
            measured = yield Step(np.asarray(currents), "driving", log)

    return run()


# Shares of the travel that a campaign on a machine uses: room for what a test is faster than its ramps say.

START = 0.04  # of the travel, distance of the start of a test from the end of travel; chosen
RAMP_TRAVEL = 0.08  # of the travel, at which a ramp ends; chosen: 20 mm of the bench's 250
TEST_TRAVEL = 0.6  # of the travel that a PRBS test may use; chosen
CYCLE_TRAVEL = (0.15, 0.85)  # of the travel, within which cycles stay; chosen
FASTEST_PER_S = 0.35  # travels in a second, fastest stroke of a test; chosen: the pump's limit of the bench


def campaign(
    plan: CampaignPlan, displacement: float, limits: Limits, step_s: float, units: tuple[str, str]
) -> Generator[Step, float, None]:
    """Yield the steps of a campaign, from a displacement; units are those of commands and displacement.

    Raises:
        InputError: a ramp ended before the piston moved.
    """
    static: dict[str, StaticResult] = {}
    # Ramps first: no test can be made before the dead zones and speeds are known that they show.
    ramp_travel = RAMP_TRAVEL * limits.travel
    for direction in plan.excited:
        ramps = []
        for number in range(1, plan.ramps + 1):
            displacement = yield from move(displacement, _start(direction, limits), limits, step_s)
            top = limits.commands[DIRECTIONS.index(direction)]
            # Up to the limit, as the dead zone is not known; the travel ends the ramp once it has shown it.
            command = two_channel_command(direction, np.linspace(0.0, top, round(plan.ramp_s / step_s) + 1))
            name = f"ramp-{direction}-{number:02d}"
            measured = yield from apply(displacement, command, name, limits, step_s, ramp_travel)
            ramps.append(_record(name, direction, command, measured, step_s, units))
            displacement = measured[-1]
        yield Step(CLOSED, "settling")  # the valves are closed while the ramps are evaluated
        try:
            static[direction] = evaluate_ramps(ramps, direction)
        except LogError as error:
            raise InputError(
                f"{error.reason}; raise the largest command in the limits file, or make ramps longer"
            ) from error
    rng = np.random.default_rng(plan.seed)
    for number in range(1, plan.tests + 1):
        for direction in plan.directions:  # in turn: each ends near where the other begins
            displacement = yield from move(displacement, _start(direction, limits), limits, step_s)
            # So slow that at this command throughout it stays within its share of the travel.
            highest = _highest(direction, static, limits, TEST_TRAVEL * limits.travel / plan.test_s)
            command = binary_command(highest, static[direction].dead_zone, plan.test_s, rng, step_s)
            rows = two_channel_command(direction, command)
            measured = yield from apply(displacement, rows, f"{direction}-{number:02d}", limits, step_s)
            displacement = measured[-1]
    for number in range(1, plan.cycles + 1):
        low, high = (limits.displacement[0] + share * limits.travel for share in CYCLE_TRAVEL)
        # From somewhere within: a cycle that began at an end could go one way only.
        displacement = yield from move(displacement, rng.uniform(low, high), limits, step_s)
        rows = cycle_commands(
            static,
            {name: _highest(name, static, limits, FASTEST_PER_S * limits.travel) for name in DIRECTIONS},
            start_mm=displacement,
            displacement_range=(low, high),
            duration_s=plan.cycle_s,
            seed=int(rng.integers(2**31)),
            step_s=step_s,
        )
        measured = yield from apply(displacement, rows, f"cycle-{number:02d}", limits, step_s)
        displacement = measured[-1]


def _start(direction: str, limits: Limits) -> float:
    low, high = limits.displacement
    return low + START * limits.travel if direction == LIFTING else high - START * limits.travel


def _highest(direction: str, static: Mapping[str, StaticResult], limits: Limits, speed: float) -> float:
    """Return the largest effective command: within its limit, and not faster than a speed."""
    result = static[direction]
    largest = limits.commands[DIRECTIONS.index(direction)] - result.dead_zone
    return min(largest, speed / result.speed_per_command)


def _record(
    name: str,
    direction: str,
    commands: np.ndarray,
    measured: list[float],
    step_s: float,
    units: tuple[str, str],
) -> Record:
    """Return a ramp as a record; a displacement that was not measured keeps its last value."""
    displacement = np.asarray(measured)
    valid = np.flatnonzero(np.isfinite(displacement))  # the first is: a ramp begins after a measured move
    samples = np.arange(len(displacement))
    role = COMMAND[direction]
    return Record(
        name,
        step_s,
        {
            DISPLACEMENT: displacement[valid][np.maximum(np.searchsorted(valid, samples, "right") - 1, 0)],
            role: commands[: len(measured), DIRECTIONS.index(direction)],
        },
        {DISPLACEMENT: units[1], role: units[0]},
        kind=RAMP,
    )


CLOSED_STEP = Step(np.zeros(2), "settling")
