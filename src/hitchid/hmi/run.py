"""A run: the plan of the operator while it is carried out, with its logs."""

import os
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np

from hitchid._support.inert import toml_text
from hitchid.bench.excitation import StaticResult, binary_command, cycle_commands, evaluate_ramps
from hitchid.control import PositionController, load_controller
from hitchid.errors import InputError, LogError
from hitchid.hmi import plans, project
from hitchid.hmi.disk import Disk
from hitchid.hmi.plans import CampaignPlan, Limits
from hitchid.hmi.program import Program, Step, Target, apply, check_clock_and_units, drive, move
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.source import CLOSED, LIFTING_COMMAND, REQUIRED, Reading, Source
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, RAMP, Record

# Program of a campaign on a machine: ramps, then tests within what the ramps have shown.

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
            command = _both(direction, np.linspace(0.0, top, round(plan.ramp_s / step_s) + 1))
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
        self._disk.put(self._make_folder)

    def _make_folder(self) -> None:
        campaign_file = f"{self.folder}/{project.CAMPAIGN_FILE}"
        if self.plan.kind != "drive" and not os.path.lexists(self._root / campaign_file):
            lines = ["[signals]", 'time = "time_s"']
            for signal in self._signals:
                if signal.name in REQUIRED:
                    column, unit = toml_text(signal.column), toml_text(signal.unit)
                    lines.append(f"{signal.name} = {{ column = {column}, unit = {unit} }}")
            project.write_new(self._root, campaign_file, "\n".join([*lines, ""]).encode())
        if self.plan.kind != "campaign":
            project.place(self._root, f"{self.folder}/{self.plan.name}.csv")
        self.has_folder = True

    def advance(self, displacement: float) -> bool:
        """Take the step of a sample from its displacement; False at the end of the plan.

        Raises:
            HitchError: the plan cannot go on.
        """
        try:
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
