"""Program of a campaign on a machine: ramps, then tests within what the ramps have shown."""

from collections.abc import Generator, Mapping

import numpy as np

from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, RAMP, Record
from hitchid.errors import InputError, LogError
from hitchid.experiments.drawn_commands import binary_command, cycle_commands
from hitchid.experiments.static_test import StaticResult, evaluate_ramps
from hitchid.hmi.limits import Limits
from hitchid.hmi.plans import CampaignPlan
from hitchid.hmi.program import Step, apply, move
from hitchid.hmi.source import CLOSED

START = 0.04  # of the travel, distance of the start of a test from the end of travel; chosen
RAMP_TRAVEL = 0.08  # of the travel, at which a ramp ends; chosen: 20 mm of the bench's 250
TEST_TRAVEL = 0.6  # of the travel that a PRBS test may use; chosen
CYCLE_TRAVEL = (0.15, 0.85)  # of the travel, within which cycles stay; chosen
FASTEST_PER_S = 0.35  # travels in a second, fastest stroke of a test; chosen: the pump's limit of the bench


def campaign(
    plan: CampaignPlan, displacement: float, limits: Limits, step_s: float, units: tuple[str, str]
) -> Generator[Step, float, None]:
    """Yield the steps of a campaign.

    Args:
        plan: of the operator.
        displacement: now.
        limits: of commands and travel.
        step_s: sampling time, s.
        units: of the commands and of the displacement.

    Raises:
        InputError: a ramp ended before the piston moved.
    """
    static: dict[str, StaticResult] = {}
    ramp_travel = RAMP_TRAVEL * limits.travel
    for direction in plan.excited:
        ramps = []
        for number in range(1, plan.ramps + 1):
            displacement = yield from move(displacement, _start(direction, limits), limits, step_s)
            command = _ramp(direction, plan.ramp_s, limits, step_s)
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
        for direction in plan.directions:
            displacement = yield from move(displacement, _start(direction, limits), limits, step_s)
            highest = _highest(direction, static, limits, TEST_TRAVEL * limits.travel / plan.test_s)
            command = binary_command(highest, static[direction].dead_zone, plan.test_s, rng, step_s)
            rows = _both(direction, command)
            measured = yield from apply(displacement, rows, f"{direction}-{number:02d}", limits, step_s)
            displacement = measured[-1]
    for number in range(1, plan.cycles + 1):
        low, high = (limits.displacement[0] + share * limits.travel for share in CYCLE_TRAVEL)
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


def _ramp(direction: str, duration_s: float, limits: Limits, step_s: float) -> np.ndarray:
    top = limits.commands[DIRECTIONS.index(direction)]
    return _both(direction, np.linspace(0.0, top, round(duration_s / step_s) + 1))


def _both(direction: str, command: np.ndarray) -> np.ndarray:
    rows = np.zeros((len(command), len(DIRECTIONS)))
    rows[:, DIRECTIONS.index(direction)] = command
    return rows


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
    valid = np.flatnonzero(np.isfinite(displacement))
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
