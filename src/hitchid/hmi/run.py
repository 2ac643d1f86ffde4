"""A run: the plan of the operator while it is carried out, with its logs."""

import os
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from hitchid._support.inert import toml_text
from hitchid.bench.excitation import (
    StaticResult,
    binary_command,
    cycle_commands,
    evaluate_ramps,
    two_channel_command,
)
from hitchid.control import PositionController, load_controller
from hitchid.errors import InputError, LogError
from hitchid.hmi import plans, project
from hitchid.hmi.disk import Disk
from hitchid.hmi.plans import MARGIN, CampaignPlan, Limits
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.source import CLOSED, LIFTING_COMMAND, REQUIRED, Reading, Source, is_same_sampling_time
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, RAMP, Record

# Programs: a program says at each sample what is commanded, from what was measured.

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
    # It ends before the target by what the piston still coasts: braking is up to the closed valve alone.
    while direction * (target - displacement) > max(speed, 0.0) * COAST_S and stalled_s < STALLED_S:
        if speed < wanted:  # from then on the command stays: it is the one that gives this speed here
            command = min(largest, command + largest * step_s / RISE_S)
        commands = CLOSED.copy()
        commands[channel] = command
        measured = yield Step(commands, "positioning")
        # A sample without a displacement is bridged here; how many may lack one is up to the bench loop.
        displacement = measured if np.isfinite(measured) else displacement
        history = [*history[1:], displacement]
        speed = direction * (history[-1] - history[0]) / (window * step_s)
        at_rest = speed < 0.02 * wanted
        # Only at the largest command: below it the piston may rest because the valve has not opened yet.
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
        # By the direction driven: a test that begins at an end of travel must be able to leave it.
        is_up, is_down = row[0] > 0, row[1] > 0
        if (is_up and displacement > high - near_end) or (is_down and displacement < low + near_end):
            break
        if abs(displacement - measured[0]) > travel:
            break
    return measured[:-1]  # the last one was measured after the last command, which is no sample of the log


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


class Run:
    """A plan that is carried out step by step, and the log of the test that is under way.

    Attributes:
        plan: of the operator.
        step: that the program asks for at this sample.
        number: of the present log.
        displacement: at which the plan was armed.
        target: of a closed loop.
        has_folder: whether the folder of its logs was made; before that nothing should move.

    Raises:
        InputError: a file of the plan cannot be used, or its place is taken.
    """

    def __init__(
        self,
        root: Path,
        plan: plans.Plan,
        source: Source,
        limits: Limits,
        displacement: float,
        disk: Disk,
    ) -> None:
        self.plan, self.step, self.number = plan, CLOSED_STEP, 0
        self.displacement, self.has_folder = displacement, False
        self._root, self._disk = root, disk
        self.target = Target(displacement)
        self._signals = source.signals
        units = {signal.name: signal.unit for signal in source.signals}
        self.folder, self._program = self._prepare(source.step_s, limits, units)
        self._recorder: Recorder | None = None
        self._has_begun, self._log = False, ""

    def begin(self) -> None:
        """Have the folder of the logs made, which `has_folder` tells."""
        self._disk.put(self._make_folder)  # by its thread: the loop must not wait for a file

    def _make_folder(self) -> None:
        campaign_file = f"{self.folder}/{project.CAMPAIGN_FILE}"
        # A file of commands may join a campaign that has one; also a broken link is none to write through.
        if self.plan.kind != "drive" and not os.path.lexists(self._root / campaign_file):
            lines = ["[signals]", 'time = "time_s"']
            for signal in self._signals:
                if signal.name in REQUIRED:
                    column, unit = toml_text(signal.column), toml_text(signal.unit)
                    lines.append(f"{signal.name} = {{ column = {column}, unit = {unit} }}")
            project.write_new(self._root, campaign_file, "\n".join([*lines, ""]).encode())
        if self.plan.kind != "campaign":  # whose folder is its own; here the name may have been taken since
            project.place(self._root, f"{self.folder}/{self.plan.name}.csv")
        self.has_folder = True

    def advance(self, displacement: float) -> bool:
        """Take the step of a sample from its displacement; False at the end of the plan.

        Raises:
            HitchError: the plan cannot go on.
        """
        try:
            # A generator that was not begun takes no value; where it begins was given when it was armed.
            step = self._program.send(displacement) if self._has_begun else next(self._program)
        except StopIteration:
            self.step = CLOSED_STEP
            return False
        self._has_begun, self.step = True, step
        return True

    def record(self, readings: Sequence[Reading]) -> None:
        """Append the samples of the present step to its log; called after its commands were sent."""
        if self.step.log != self._log:
            self._close_log()
            self._log = self.step.log
            if self._log:
                self.number += 1
                path = f"{self.folder}/{self._log}.csv"
                self._recorder = Recorder(self._root, path, self._signals, self._disk)
        if self._recorder is not None:
            self._recorder.append(readings)

    def end(self) -> None:
        """Close the log and the plan."""
        self._program.close()
        self._close_log()

    def _close_log(self) -> None:
        if self._recorder is not None:
            recorder, self._recorder = self._recorder, None
            recorder.close()

    def describe(self, speed: int) -> dict[str, object]:
        """Return the progress as content for JSON; the time left is estimated."""
        fraction = max(self.number - 1, 0) / self.plan.total
        left_s = self.step.left_s
        # Of a campaign by its logs: how long its ramps and moves last is known afterwards only.
        if isinstance(self.plan, plans.CampaignPlan):
            left_s = (1 - fraction) * self.plan.duration_s
        return {
            "kind": self.plan.kind,
            "name": self.plan.name,
            "folder": self.folder,
            "test": self.step.log,
            "number": self.number,
            "total": self.plan.total,
            "phase": self.step.phase,
            "fraction": fraction,
            "left_s": left_s / speed,
        }

    def _prepare(self, step_s: float, limits: Limits, units: dict[str, str]) -> tuple[str, Program]:
        """Return the folder of the logs, relative to the project, and the program."""
        plan, displacement, root = self.plan, self.target.displacement, self._root

        def check_free(path: str) -> None:
            if os.path.lexists(root / path):
                raise InputError(f"{path}: exists already; choose another name")

        # What takes long, such as compiling a controller, comes after what can be refused at once.
        if isinstance(plan, plans.DrivePlan):
            check_free(f"{project.DRIVES}/{plan.name}.csv")
            content = load_controller(project.file_inside(root, plan.controller))
            check_clock_and_units(content.controller.step_s, content.units, step_s, units)
            controller = cast(PositionController, content.controller)
            return project.DRIVES, drive(controller, plan.name, displacement, self.target, limits)
        if isinstance(plan, plans.FilePlan):
            folder = f"{project.CAMPAIGNS}/{plan.campaign or plan.name}"
            check_free(f"{folder}/{plan.name}.csv")
            commands = plans.read_commands(project.file_inside(root, plan.file), step_s)
            highest = commands.max(axis=0)
            for name, largest, reached in zip(REQUIRED[:2], limits.commands, highest, strict=True):
                if reached > largest:
                    raise InputError(
                        f"{plan.file}: {name} reaches {reached:g} {units[name]}; the limit is {largest:g}"
                    )
            return folder, apply(displacement, commands, plan.name, limits, step_s)
        folder = f"{project.CAMPAIGNS}/{plan.name}"
        check_free(folder)
        pair = units[LIFTING_COMMAND], units[DISPLACEMENT]
        return folder, campaign(plan, displacement, limits, step_s, pair)
