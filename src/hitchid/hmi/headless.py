"""A campaign without a page: the same bench loop, ticked from here; in real time for a real machine."""

import contextlib
import gc
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hitchid._support import checks
from hitchid._support.jax_setup import prepare_jax
from hitchid._support.records import short_repr
from hitchid.bench import load_rig
from hitchid.errors import InputError
from hitchid.hmi import project
from hitchid.hmi.bench_loop import BenchLoop
from hitchid.hmi.bench_process import run_in_real_time
from hitchid.hmi.campaign_files import SETTINGS
from hitchid.hmi.plans import AdaptivePlan, Limits, limits_of_rig, read_goal, read_plan
from hitchid.hmi.safety import State
from hitchid.hmi.source import Source
from hitchid.hmi.sources import make_source
from hitchid.hmi.watchdog import Watchdog

CONNECT_S = 10.0  # s, longest wait for the first displacement; chosen
LISTEN_S = 1.0  # s of samples before anything moves, from which the sampling time is taken; chosen
LONGEST_PLANNING_S = 300.0  # s, longest wait for the planner where the machine stands still; chosen


@short_repr
@dataclass(frozen=True)
class CampaignResult:
    """A campaign that has ended.

    Attributes:
        folder: of its logs, which `read` and `identify` take.
        reason: why it ended.
        further: what another five minutes would bring.
        minutes: bench time that was spent.
        rounds: after each test its bench minutes, errors and numbers of determined parameters.
        report: where its report lies, or why there is none.
        settings: of `identify`, for fewer tests than a form is chosen by; None where there are enough.
    """

    folder: Path
    reason: str
    further: str
    minutes: float
    rounds: tuple[Mapping[str, Any], ...]
    report: str
    settings: Path | None

    def describe(self) -> dict[str, object]:
        """Return the content of JSON output."""
        places = {"folder": str(self.folder), "settings": self.settings and str(self.settings)}
        return {**vars(self), **places, "rounds": list(self.rounds)}


def campaign(
    source: str | Source,
    out: str | Path,
    *,
    name: str = "campaign",
    minutes: float = 15.0,
    goal: str | None = None,
    limits: Limits | str | Path | None = None,
    resume: bool = False,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> CampaignResult:
    """Run a campaign that chooses its own tests on a machine, and return why it ended.

    Args:
        source: the machine: `rig:NAME`, `serial:DEVICE`, `udp:PORT`, `can:FILE`, `MODULE:OBJECT`, or an
            object as `hitchid.hmi.Source` names it.
        out: folder of the project; its `campaigns/NAME` holds the logs.
        name: of the campaign.
        minutes: of bench time at most.
        goal: such as `free run 0.2 mm in 10 s`, in the machine's unit.
        limits: of commands and travel, or the file of them; a virtual bench by name has its own.
        resume: go on with a campaign of this name that was stopped.
        seed: of all random draws.
        progress: called with what is done and the share of the time that is spent.

    Raises:
        InputError: the source, its limits, the goal or the name cannot be used, or the campaign was stopped:
            its logs stay, and it goes on with `resume`.
    """
    root = checks.path(out, "out")
    root.mkdir(parents=True, exist_ok=True)
    plan = {
        "kind": "adaptive",
        "name": name,
        "minutes": minutes,
        "goal": goal,
        "resume": resume,
        "seed": seed,
    }
    checked = read_plan(plan)
    prepare_jax()
    given = Path(limits) if isinstance(limits, str) else limits
    text = source if isinstance(source, str) else "given"
    made = make_source(text) if isinstance(source, str) else source
    if given is None and text.startswith("rig"):
        given = limits_of_rig(load_rig(text.partition(":")[2] or "nominal"))
    if given is None:
        raise InputError(f"{made.label}: has no limits; give the limits file of the machine")
    goal_unit = read_goal(checked.goal).unit if isinstance(checked, AdaptivePlan) and checked.goal else None
    loop = BenchLoop(
        root,
        allow_output=True,
        limits_file=given,
        # A virtual bench stands still while nobody ticks it.
        watch=None if made.virtual else partial(Watchdog, tell=_tell_zero),
        make=lambda _: made,
    )
    lock = project.lock(root, "a campaign")
    try:
        return _Operator(loop, made, progress or (lambda *_: None)).run(
            {**plan, "unattended": made.virtual}, root, goal_unit
        )
    finally:
        run_in_real_time(wanted=False)
        loop.close()
        if lock is not None:
            os.close(lock)


class _Operator:
    """Who ticks the loop: on a clock of its own for a virtual bench, in real time else."""

    def __init__(self, loop: BenchLoop, source: Source, progress: Callable[[str, float], None]) -> None:
        self._loop, self._source, self._progress = loop, source, progress
        self._now_s = 0.0 if source.virtual else time.monotonic()
        self._due_s = self._now_s

    def run(self, plan: Mapping[str, Any], root: Path, goal_unit: str | None) -> CampaignResult:
        loop = self._loop
        loop.server_alive(self._now_s)
        loop.handle({"type": "connect", "source": "given"}, self._now_s)
        self._check_unit(goal_unit)
        self._listen()
        # Before it is armed, from when on a watchdog counts every tick: what there is now stays.
        gc.collect()
        gc.freeze()
        run_in_real_time(wanted=not self._source.virtual)
        self._catch_up()
        loop.handle({"type": "arm", "plan": plan}, self._now_s)
        self._catch_up()
        run = loop.run
        assert run is not None  # noqa: S101 - armed
        assert run.planner is not None  # noqa: S101 - of a campaign that chooses its tests
        loop.handle({"type": "start"}, self._now_s)
        planner, shown = run.planner, ("", "")
        while loop.state is State.RUNNING:
            if self._source.virtual and run.step.phase == "planning" and run.has_folder:
                planner.wait(LONGEST_PLANNING_S)
            elif self._source.virtual and not run.has_folder:
                time.sleep(0.001)  # the disk makes it, on its own clock
            self._tick()
            now = (run.step.phase, planner.why)
            if now != shown and run.step.phase in TOLD:
                self._progress(
                    TOLD[run.step.phase] or planner.why, min(1.0, planner.minutes / float(plan["minutes"]))
                )
                shown = now
        reason = str(loop.describe()["reason"])
        folder = root / run.folder
        if reason:
            raise InputError(f"{reason}; the logs so far are in {folder}, go on with resume")
        result, settings = planner.result, folder / SETTINGS
        return CampaignResult(
            folder,
            str(result.get("reason", "")),
            str(result.get("further", "")),
            float(result.get("minutes", planner.minutes)),
            tuple(result.get("rounds", ())),
            str(result.get("report", "")),
            settings if settings.exists() else None,
        )

    def _tick(self) -> None:
        """Tick once, with the signs of life of whoever runs this; of a machine when it is due."""
        step_s = self._loop.tick_s
        if self._source.virtual:
            self._now_s += step_s
        else:
            self._due_s += step_s
            time.sleep(max(0.0, self._due_s - time.monotonic()))
            self._now_s = time.monotonic()
        self._loop.server_alive(self._now_s)
        self._loop.page_alive(self._now_s)
        self._loop.tick(self._now_s)

    def _catch_up(self) -> None:
        """Count from now: what came before, such as compiling, was no tick."""
        if not self._source.virtual:
            self._now_s = self._due_s = time.monotonic()
        self._loop.server_alive(self._now_s)
        self._loop.page_alive(self._now_s)
        self._tick()

    def _listen(self) -> None:
        """Wait for a displacement, then take the sampling time from what comes."""
        begun_s = self._now_s
        while not self._loop.is_measured:
            if self._now_s - begun_s > CONNECT_S:
                raise InputError(f"{self._source.label}: sent no displacement for {CONNECT_S:g} s")
            self._tick()
        heard_s = self._now_s
        while self._now_s - heard_s < LISTEN_S:
            self._tick()

    def _check_unit(self, goal_unit: str | None) -> None:
        unit = next(signal.unit for signal in self._source.signals if signal.name == "displacement")
        if goal_unit is not None and goal_unit != unit:
            raise InputError(
                f"goal: expected an error in {unit}, the unit of the displacement, got {goal_unit}"
            )


# Phases that are told, and as what; a test says itself what it is for.
TOLD = {
    "rest": "at rest: noise and drift",
    "ramp": "careful start: a command that grows until something moves",
    "test": "",
}


def _tell_zero(is_zero_sent: bool) -> None:
    text = "has sent zero to the machine" if is_zero_sent else "could not send zero: close its valves by hand"
    with contextlib.suppress(OSError):
        sys.stderr.write(f"hitchid: the watchdog {text}\n")
