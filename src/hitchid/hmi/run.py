"""A run: the plan of the operator while it is carried out, with its logs."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from hitchid._support.inert import toml_text
from hitchid.control import PositionController, load_controller
from hitchid.errors import InputError
from hitchid.hmi import adaptive, plans, project
from hitchid.hmi.campaign_files import read_progress
from hitchid.hmi.disk import Disk
from hitchid.hmi.planner_link import PlannerLink
from hitchid.hmi.programs import (
    CLOSED_STEP,
    Machine,
    Program,
    Target,
    apply,
    campaign,
    check_clock_and_units,
    drive,
)
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.source import LIFTING_COMMAND, REQUIRED, Reading
from hitchid.logs import DISPLACEMENT


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
        machine: Machine,
        displacement: float,
        disk: Disk,
    ) -> None:
        self.plan, self.step, self.number = plan, CLOSED_STEP, 0
        self.displacement, self.has_folder = displacement, False
        self._root, self._disk = root, disk
        self.target = Target(displacement)
        self._signals = machine.signals
        self.planner: PlannerLink | None = None
        self.folder, self._program = self._prepare(machine)
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
        # A campaign's folder is its own; here the name may have been taken since.
        if self.plan.kind in ("file", "drive"):
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
        if self.planner is not None:
            self.planner.end()

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
        if isinstance(self.plan, plans.AdaptivePlan) and self.planner is not None:
            fraction = min(1.0, self.planner.minutes / self.plan.minutes)
            left_s = 60 * max(0.0, self.plan.minutes - self.planner.minutes)
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
            "why": self.planner.why if self.planner else "",
        }

    def _prepare(self, machine: Machine) -> tuple[str, Program]:
        """Return the folder of the logs, relative to the project, and the program."""
        plan, displacement, root = self.plan, self.target.displacement, self._root
        step_s, limits = machine.step_s, machine.limits
        units = {signal.name: signal.unit for signal in machine.signals}

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
        if isinstance(plan, plans.AdaptivePlan):
            if not plan.resume:
                check_free(folder)
            taken = {f"start/{log.stem}" for log in (root / folder / "start").glob("*.csv")}
            started = read_progress(root / folder) if plan.resume else None
            self.planner = PlannerLink(root, folder, plan, machine, self._disk)
            return folder, adaptive.adaptive(displacement, machine, self.planner, started, taken)
        check_free(folder)
        pair = units[LIFTING_COMMAND], units[DISPLACEMENT]
        return folder, campaign(plan, displacement, limits, step_s, pair)
