"""A run: the plan of the operator while it is carried out, with its logs."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import numpy as np

from hitchid.control import PositionController, load_controller
from hitchid.data.record import DISPLACEMENT
from hitchid.errors import InputError, OutputError
from hitchid.hmi import plans, project
from hitchid.hmi.campaign import campaign
from hitchid.hmi.drive_program import Target, check_clock_and_units, drive
from hitchid.hmi.limits import Limits
from hitchid.hmi.program import Program, Step, apply
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.source import LIFTING_COMMAND, REQUIRED, Reading, Signal, Source

CLOSED_STEP = Step(np.zeros(2), "settling")


class Run:
    """A plan that is carried out step by step, and the log of the test that is under way.

    Args:
        root: folder of the project.
        plan: of the operator.
        source: that is driven.
        limits: of commands and travel.
        displacement: now.

    Attributes:
        plan: of the operator.
        step: that the program asks for at this sample.
        number: of the present log.
        displacement: at which the plan was armed.
        target: of a closed loop.

    Raises:
        InputError: a file of the plan cannot be used, or its place is taken.
    """

    def __init__(
        self, root: Path, plan: plans.Plan, source: Source, limits: Limits, displacement: float
    ) -> None:
        self.plan, self.step, self.number = plan, CLOSED_STEP, 0
        self.displacement = displacement
        self.target = Target(displacement)
        self._signals = source.signals
        units = {signal.name: signal.unit for signal in source.signals}
        self._folder, self._program = self._prepare(root, source.step_s, limits, units)
        self._recorder: Recorder | None = None
        self._has_begun, self._log = False, ""

    @property
    def folder(self) -> str:
        """Folder of the logs, relative to the project."""
        return (
            f"{self._folder.parent.name}/{self._folder.name}" if self.plan.kind != "drive" else project.DRIVES
        )

    def begin(self) -> None:
        """Make the folder of the logs.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            if self.plan.kind != "drive" and not (self._folder / project.CAMPAIGN_FILE).exists():
                text = _campaign_file(self._signals)
                (self._folder / project.CAMPAIGN_FILE).write_text(text, encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{self._folder}: cannot be written: {error.strerror}") from error

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
        self._has_begun = True
        self.step = step
        return True

    def record(self, readings: Sequence[Reading]) -> None:
        """Append the samples of the present step to its log; called after its commands were sent.

        Raises:
            OutputError: it cannot be written.
        """
        if self.step.log != self._log:
            self._close_log()
            self._log = self.step.log
            if self._log:
                self.number += 1
                self._recorder = Recorder(self._folder / f"{self._log}.csv", self._signals)
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

    def _prepare(
        self, root: Path, step_s: float, limits: Limits, units: dict[str, str]
    ) -> tuple[Path, Program]:
        plan, displacement = self.plan, self.target.displacement
        if isinstance(plan, plans.DrivePlan):
            folder = root / project.DRIVES
            _check_free(folder / f"{plan.name}.csv")
            controller = load_controller(project.inside(root, plan.controller)).controller
            check_clock_and_units(controller.step_s, step_s, units)
            return folder, drive(
                cast(PositionController, controller), plan.name, displacement, self.target, limits
            )
        if isinstance(plan, plans.FilePlan):
            folder = root / project.CAMPAIGNS / (plan.campaign or plan.name)
            _check_free(folder / f"{plan.name}.csv")
            commands = plans.read_commands(project.inside(root, plan.file), step_s)
            for name, largest, highest in zip(
                REQUIRED[:2], limits.commands, commands.max(axis=0), strict=True
            ):
                if highest > largest:
                    raise InputError(
                        f"{plan.file}: {name} reaches {highest:g} {units[name]}; the limit is {largest:g}"
                    )
            return folder, apply(displacement, commands, plan.name, limits, step_s)
        folder = root / project.CAMPAIGNS / plan.name
        _check_free(folder)
        pair = units[LIFTING_COMMAND], units[DISPLACEMENT]
        return folder, campaign(plan, displacement, limits, step_s, pair)


def _check_free(path: Path) -> None:
    if path.exists():
        raise InputError(f"{path.parent.name}/{path.name}: exists already; choose another name")


def _campaign_file(signals: Sequence[Signal]) -> str:
    """Return the signal map of the logs."""
    lines = ["[signals]", 'time = "time_s"']
    for signal in signals:
        if signal.name in REQUIRED:
            column, unit = json.dumps(signal.column), json.dumps(signal.unit)
            lines.append(f"{signal.name} = {{ column = {column}, unit = {unit} }}")
    return "\n".join(lines) + "\n"
