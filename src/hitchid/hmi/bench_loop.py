"""The bench loop: owns source, recorder and safety; one `tick` for each sampling time."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hitchid._support import checks
from hitchid.errors import HitchError, InputError, OutputError
from hitchid.hmi import plans, project
from hitchid.hmi.connected_source import ConnectedSource, connect
from hitchid.hmi.disk import Disk
from hitchid.hmi.plans import MARGIN, Limits
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.run import Machine, Run
from hitchid.hmi.safety import Safety, State
from hitchid.hmi.source import CLOSED, DISPLACEMENT, REQUIRED, Reading, Source, describe
from hitchid.hmi.sources import make_source
from hitchid.hmi.watchdog import Watchdog

LONGEST_SILENCE_S = 0.5  # s without a sign of life of server or page, after which the loop stops
# s beyond its sampling time, after which a tick of a machine in motion is late, and the run over: its valves
# have held an old command. Chosen: zero is sent within 0.2 s, also to the slowest source that may be moved.
LATEST_S = 0.1
TICK_S = 0.01  # s between ticks without a source
# Samples whose intervals are kept; the clock of the source counts unless they are longer by half; chosen.
INTERVALS, LIKE_STEP = 50, 1.5
SENSOR_SILENCE_S, SILENT_SAMPLES = 0.05, 3  # s, and in samples: longest silence of a sensor; chosen

Request = Mapping[str, Any]


class BenchLoop:
    """Source, recorder and safety of one bench.

    Only the state `running` sends commands other than zero: within the limits, never both at once. Nothing in
    a tick waits: files are handed to the disk's thread, and a tick that comes late ends the run.

    Args:
        root: folder of the project.
        allow_output, limits_file: whether a real machine may be moved, and its limits.
        longest_silence_s: without a sign of life while armed or running, s.
        disk: that takes what is written.
        watch: makes the watchdog of a source that is armed, from what sends zero and the longest silence, s;
            none without it.
        make: returns the source of a name.
    """

    def __init__(
        self,
        root: Path,
        *,
        allow_output: bool = False,
        limits_file: Path | Limits | None = None,
        longest_silence_s: float = LONGEST_SILENCE_S,
        disk: Disk | None = None,
        watch: Callable[[Callable[[], None], float], Watchdog] | None = None,
        make: Callable[[str], Source] = make_source,
    ) -> None:
        self._root, self._allow_output, self._limits_file = root, allow_output, limits_file
        self._longest_silence_s = longest_silence_s
        self._safety, self._disk = Safety(), disk or Disk()
        self._connected: ConnectedSource | None = None
        self._run: Run | None = None
        self._ended_runs: list[Run] = []
        self._ticked_s, self._watch, self._make = -np.inf, watch, make
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._watchdog: Watchdog | None = None
        self._recorder: Recorder | None = None
        self._displacement, self._time_s, self._silent_s, self._measured_s = np.nan, 0.0, 0.0, 0.0
        self._commands = CLOSED
        self._requests: Mapping[str, Callable[[Request, float], None]] = {
            "connect": self._connect,
            "disconnect": lambda *_: self._lose_source(""),
            "arm": self._arm,
            "start": self._start,
            "stop": lambda request, _: self.stop(str(request.get("reason", "stopped by the operator"))[:200]),
            "reset": lambda *_: self._settle(self._safety.reset(is_connected=self._connected is not None)),
            "target": self._set_target,
            "record": self._record,
        }

    @property
    def state(self) -> State:
        """State of the loop."""
        return self._safety.state

    @property
    def commands(self) -> np.ndarray:
        """Commands that were sent last, lifting and lowering, shape [2]."""
        return self._commands

    @property
    def tick_s(self) -> float:
        """Time between ticks, s."""
        return self._connected.source.step_s if self._connected else TICK_S

    @property
    def is_virtual(self) -> bool:
        """Whether there is a source that is no real machine."""
        return self._connected is not None and self._connected.source.virtual

    @property
    def is_measured(self) -> bool:
        """Whether there has been a displacement."""
        return bool(np.isfinite(self._displacement))

    @property
    def run(self) -> Run | None:
        """The plan that is armed or carried out."""
        return self._run

    def server_alive(self, now_s: float) -> None:
        """Take a sign of life of the server."""
        self._safety = replace(self._safety, server_s=max(self._safety.server_s, now_s))

    def page_alive(self, now_s: float) -> None:
        """Take a sign of life of the operator's page."""
        self._safety = replace(self._safety, page_s=max(self._safety.page_s, now_s))

    def handle(self, request: Request, now_s: float) -> None:
        """Carry out a request of the operator.

        Raises:
            HitchError: it cannot be carried out in this state, or its content is wrong.
        """
        kind = request.get("type")
        if not isinstance(kind, str) or kind not in self._requests:
            raise InputError(f"{kind!r:.40} is no request; expected one of {', '.join(self._requests)}")
        self._requests[kind](request, now_s)

    def tick(self, now_s: float) -> list[Reading]:
        """Check the signs of life, and exchange a sample with the source; in a fast run several."""
        self._settle(self._safety.check(now_s, self._longest_silence_s))
        # Late, such as after the process was stopped for a while and goes on.
        late_s, self._ticked_s = now_s - self._ticked_s - self.tick_s, now_s
        if self.state is State.RUNNING and late_s > self._latest_s:
            self.stop(f"the bench loop was late by {late_s:.2g} s")
        try:
            self._disk.check()
        except OutputError as error:
            self.stop(str(error))
            self._end_recording()
        speed = self._connected.speed if self._connected and self.state is State.RUNNING else 1
        readings: list[Reading] = []
        for _ in range(speed):
            readings += self._sample(now_s)
        self._close_ended_run()  # after zero was sent: closing a log comes second to closing the valves
        if self.state not in (State.ARMED, State.RUNNING):
            self._end_watchdog()
        return readings

    def stop(self, reason: str) -> None:
        """Close the valves from the next sample on, and stay so until `reset`."""
        self._settle(self._safety.stop(reason))

    def close(self) -> None:
        """End the run and the recording, close the source, and give the disk a moment for the logs."""
        self._lose_source("the bench loop was ended")
        self._disk.finish()

    def operator_left(self) -> None:
        """Stop an attended run whose operator has gone, or has handed over."""
        if self._safety.is_attended and self.state in (State.ARMED, State.RUNNING):
            self.stop("the operator left")

    def describe(self) -> dict[str, object]:
        """Return the state as content for JSON."""
        run, recorder, connected = self._run, self._recorder, self._connected
        return {
            "state": self.state,
            "reason": self._safety.reason,
            "source": connected and describe(connected.source, connected.name, connected.speed),
            "run": run.describe(connected.speed) if run and connected else None,
            "recording": {"file": recorder.path.name, "samples": recorder.samples} if recorder else None,
            "limits": connected.limits.describe() if connected and connected.limits else None,
            "target_mm": run.target.displacement if run and run.plan.kind == "drive" else None,
            "mode": ("lifting" if self._commands[0] else "lowering") if self._commands.any() else "hold",
            "now_s": self._time_s,
        }

    @property
    def _latest_s(self) -> float:
        """How late a tick may be, s; a virtual source stands still meanwhile, and so holds no old command."""
        return self._longest_silence_s if self.is_virtual else LATEST_S

    def _sample(self, now_s: float) -> Sequence[Reading]:
        """Read, decide, write and record: the commands of a sample follow from its own displacement."""
        connected = self._connected
        if connected is None:
            return ()
        try:
            readings = connected.read()
        except Exception as error:  # of a source from outside the package it may be any
            self._lose_source(_sentence(error))
            return ()
        self._take(connected, readings, now_s)
        self._commands = self._decide()
        # As late as can be: this process may have been frozen since the tick began.
        if self._watchdog is not None and not self._watchdog.alive():
            self.stop("the bench loop was silent for too long, and its watchdog has sent zero")
            self._commands = CLOSED
        try:
            connected.write(self._commands)
        except Exception as error:
            self._lose_source(_sentence(error))
            return ()
        readings = [_with_commands(reading, self._commands) for reading in readings]
        if self._recorder is not None:
            self._recorder.append(readings)
        if self._run is not None:
            self._run.record(readings)
        return readings

    def _decide(self) -> np.ndarray:
        """Advance the run by one sample; return its commands within their limits, zero in any other state."""
        try:
            limits = self._connected.limits if self._connected else None
            # Nothing moves before the disk has the folder: a run must not go on without its log.
            if self.state is not State.RUNNING or self._run is None or not self._run.has_folder:
                return CLOSED
            if not self._run.advance(self._displacement):
                self._settle(self._safety.finish())
            if self._run is None or limits is None:
                return CLOSED
            wanted = np.nan_to_num(self._run.step.commands, nan=0.0, posinf=0.0, neginf=0.0)
            if np.all(wanted > 0):
                self.stop("both valves were commanded at once")
                return CLOSED
            return np.clip(wanted, 0.0, limits.commands)
        except Exception as error:  # whatever a program or a controller raises closes the valves
            self.stop(_sentence(error))
            return CLOSED

    def _take(self, connected: ConnectedSource, readings: Sequence[Reading], now_s: float) -> None:
        """Take the newest displacement; stop where there is none, or one outside the limits."""
        # A virtual source may run faster than time: what it lacks is counted on its own clock.
        measured = [reading.values[REQUIRED.index(DISPLACEMENT)] for reading in readings]
        valid = [value for value in measured if np.isfinite(value)]
        if self.state is not State.RUNNING:  # a sensor that fails must not be taken for a slow one
            times = [self._time_s, *(reading.time_s for reading in readings)][0 if self._time_s else 1 :]
            self._intervals.extend(np.diff(times))
        self._time_s = readings[-1].time_s if readings else self._time_s
        clock_s = self._time_s if connected.source.virtual else now_s
        self._measured_s = clock_s if valid else self._measured_s
        self._silent_s = clock_s - self._measured_s
        self._displacement = valid[-1] if valid else self._displacement
        limits = connected.limits
        if limits is None or self.state is not State.RUNNING:
            return
        if self._silent_s > self._longest_sensor_silence_s(limits):
            self.stop(f"no displacement for {self._silent_s:.2g} s")
        elif limits.is_beyond(self._displacement):
            low, high = limits.displacement
            self.stop(f"displacement {self._displacement:.4g} is outside {low:g} to {high:g}")

    def _lose_source(self, reason: str) -> None:
        """Close valves, source and logs; a run is stopped by that, and the reason is kept."""
        connected, self._connected, self._commands = self._connected, None, CLOSED
        # Zero first; the watchdog ends after it, so that there is always somebody who would send it.
        if connected is not None and not connected.close():
            reason = f"{reason}; zero could not be sent: close the valves of the machine by hand"
        self._end_watchdog()
        self._settle(self._safety.disconnect(reason))
        self._close_ended_run()
        self._end_recording()

    def _end_watchdog(self) -> None:
        if self._watchdog is not None:
            self._watchdog.end()
            self._watchdog = None

    def _settle(self, safety: Safety) -> None:
        """Take a state; a run ends with it, and its log is closed after zero was sent."""
        self._safety = safety
        if safety.state not in (State.ARMED, State.RUNNING) and self._run is not None:
            self._ended_runs, self._run = [*self._ended_runs, self._run], None

    def _close_ended_run(self) -> None:
        runs, self._ended_runs = self._ended_runs, []
        for run in runs:
            run.end()

    def _connect(self, request: Request, now_s: float) -> None:
        connected = self._safety.connect()
        self._connected = connect(
            request, self._root, limits=self._limits_file, allow_output=self._allow_output, make=self._make
        )
        self._intervals.clear()
        # Silence of a sensor is counted on the clock of a virtual source, which may run faster than time.
        self._measured_s = 0.0 if self._connected.source.virtual else now_s
        self._displacement, self._silent_s, self._time_s = np.nan, 0.0, 0.0
        self._settle(connected)

    def _arm(self, request: Request, now_s: float) -> None:
        plan = plans.read_plan(request.get("plan"))
        armed = self._safety.arm(is_attended=not plan.unattended, now_s=now_s)
        connected = self._connected
        assert connected is not None  # noqa: S101 - idle has a source
        source = connected.source
        if not source.can_move:
            raise InputError(f"{source.label}: takes no commands; connect the virtual bench or a machine")
        if not connected.takes_output:
            raise InputError(
                f"{source.label}: is a machine; start hitchid hmi with --allow-output and --limits"
            )
        if connected.limits is None:
            raise InputError(f"{source.label}: has no limits; start hitchid hmi with --limits FILE")
        if plan.unattended and not source.virtual:
            raise InputError("unattended: expected false; only the virtual bench runs without its operator")
        self._check_sensor(connected.limits)
        # The state changes last: whatever a plan's files raise leaves the bench idle.
        machine = Machine(source.signals, source.step_s, self.interval_s, connected.limits, source.virtual)
        self._run = Run(self._root, plan, machine, self._displacement, self._disk)
        self._end_watchdog()  # of a plan that was armed, stopped and reset before the next tick
        if connected.is_watched and self._watch is not None:
            self._watchdog = self._watch(partial(connected.write, CLOSED), source.step_s + self._latest_s)
        self._safety = armed

    @property
    def interval_s(self) -> float:
        """Time between samples as measured while nothing ran, s; that of the source before any came."""
        assert self._connected is not None  # noqa: S101 - asked for with a source
        step_s = self._connected.source.step_s
        measured = float(np.median(self._intervals)) if self._intervals else step_s
        return step_s if measured < LIKE_STEP * step_s else measured

    def _longest_sensor_silence_s(self, limits: Limits) -> float:
        if limits.sensor_silence_s is not None:
            return limits.sensor_silence_s
        return min(max(SENSOR_SILENCE_S, SILENT_SAMPLES * self.interval_s), 1.0)

    def _check_sensor(self, limits: Limits) -> None:
        if not np.isfinite(self._displacement) or self._silent_s > self._longest_sensor_silence_s(limits):
            raise InputError("no displacement is measured now; check the sensor")

    def _start(self, _: Request, now_s: float) -> None:
        running = self._safety.start(now_s)
        connected, run = self._connected, self._run
        assert connected is not None  # noqa: S101 - armed has a source, its limits and a run
        assert connected.limits is not None  # noqa: S101
        assert run is not None  # noqa: S101
        self._check_sensor(connected.limits)
        if abs(self._displacement - run.displacement) > MARGIN * connected.limits.travel:
            raise InputError("the hitch has moved since it was armed; stop, reset and arm again")
        run.begin()
        self._safety = running

    def _set_target(self, request: Request, _: float) -> None:
        target = checks.number(request.get("mm"), "mm")
        if self._run is None or self._run.plan.kind != "drive":
            raise InputError("target: there is no closed loop; arm one first")
        self._run.target.displacement = target

    def _record(self, request: Request, _: float) -> None:
        if not request.get("on"):
            self._end_recording()
        elif self._connected is None:
            raise InputError("record: there is no source; connect one first")
        elif self._recorder is None:
            now = datetime.now().astimezone()  # to the millisecond: two recordings may begin in one second
            path = f"{project.RECORDINGS}/{now:%Y-%m-%d_%H-%M-%S}-{now.microsecond // 1000:03d}.csv"
            self._recorder = Recorder(self._root, path, self._connected.source.signals, self._disk)

    def _end_recording(self) -> None:
        if self._recorder is not None:
            recorder, self._recorder = self._recorder, None
            recorder.close()


def _sentence(error: Exception) -> str:
    return str(error) if isinstance(error, HitchError) else f"{type(error).__name__}: {error}"


def _with_commands(reading: Reading, commands: np.ndarray) -> Reading:
    """Return a sample whose commands are those of the loop where the source gives none."""
    given = reading.values[: len(commands)]
    filled = (own if value != value else value for value, own in zip(given, commands, strict=True))
    return reading._replace(values=(*map(float, filled), *reading.values[len(commands) :]))
