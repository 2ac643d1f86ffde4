"""The bench loop: owns source, recorder and safety; one `tick` for each sampling time."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from hitchid._support import checks
from hitchid.errors import HitchError, InputError, OutputError
from hitchid.hmi import plans, project
from hitchid.hmi.limits import Limits, limits_of_rig, read_limits
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.run import Run
from hitchid.hmi.safety import Safety, State
from hitchid.hmi.source import CLOSED, DISPLACEMENT, REQUIRED, Reading, Source, describe
from hitchid.hmi.sources import make_source
from hitchid.rig.parameter_files import parameter_sets

LONGEST_SILENCE_S = 0.5  # s without a sign of life of server or page, after which the loop stops
FASTEST = 20  # samples of a virtual source in a tick at most; chosen: more than two cores reach
TICK_S = 0.01  # s between ticks without a source

Request = Mapping[str, Any]


class BenchLoop:
    """Source, recorder and safety of one bench.

    Only the state `running` sends commands other than zero: within the limits, never both at once.

    Args:
        root: folder of the project.
        allow_output: whether a real machine may be moved.
        limits_file: limits of a real machine.
        longest_silence_s: without a sign of life while armed or running, s.
    """

    def __init__(
        self,
        root: Path,
        *,
        allow_output: bool = False,
        limits_file: Path | None = None,
        longest_silence_s: float = LONGEST_SILENCE_S,
    ) -> None:
        self._root, self._allow_output, self._limits_file = root, allow_output, limits_file
        self._longest_silence_s = longest_silence_s
        self._safety = Safety()
        self._source: Source | None = None
        self._source_name, self._speed = "", 1
        self._limits: Limits | None = None
        self._run: Run | None = None
        self._recorder: Recorder | None = None
        self._displacement, self._time_s, self._silent_s = np.nan, 0.0, 0.0
        self._commands = CLOSED
        self._requests: Mapping[str, Callable[[Request, float], None]] = {
            "connect": self._connect,
            "disconnect": self._disconnect,
            "arm": self._arm,
            "start": self._start,
            "stop": self._stop,
            "reset": self._reset,
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
        return self._source.step_s if self._source else TICK_S

    def server_alive(self, now_s: float) -> None:
        """Take a sign of life of the server."""
        self._safety = replace(self._safety, server_s=now_s)

    def page_alive(self, now_s: float) -> None:
        """Take a sign of life of the operator's page."""
        self._safety = replace(self._safety, page_s=now_s)

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
        readings: list[Reading] = []
        for _ in range(self._speed if self.state is State.RUNNING else 1):
            readings += self._sample()
        return readings

    def stop(self, reason: str) -> None:
        """Close the valves from the next sample on, and stay so until `reset`."""
        self._settle(self._safety.stop(reason))

    def close(self) -> None:
        """End the run and the recording, and close the source."""
        self._lose_source("the bench loop was ended")

    def describe(self) -> dict[str, object]:
        """Return the state as content for JSON."""
        run, recorder, limits = self._run, self._recorder, self._limits
        units = {signal.name: signal.unit for signal in self._source.signals} if self._source else {}
        return {
            "state": self.state,
            "reason": self._safety.reason,
            "source": describe(self._source, self._source_name, self._speed) if self._source else None,
            "run": run.describe(self._speed) if run else None,
            "recording": {"file": recorder.path.name, "samples": recorder.samples} if recorder else None,
            "limits": limits
            and {
                **limits.describe(),
                "units": {"command": units.get(REQUIRED[0]), "displacement": units.get(DISPLACEMENT)},
            },
            "target_mm": run.target.displacement if run and run.plan.kind == "drive" else None,
            "mode": ("lifting" if self._commands[0] else "lowering") if self._commands.any() else "hold",
            "now_s": self._time_s,
        }

    def _sample(self) -> Sequence[Reading]:
        """Read, decide, record and write: the commands of a sample follow from its own displacement."""
        if self._source is None:
            return ()
        try:
            readings = self._source.read()
            self._take(readings)
        except Exception as error:  # of a source from outside the package it may be any
            self._lose_source(_sentence(error))
            return ()
        self._commands = self._decide()
        readings = [_with_commands(reading, self._commands) for reading in readings]
        self._record_samples(readings)
        try:
            self._write(self._source, self._commands)
        except Exception as error:
            self._lose_source(_sentence(error))
        return readings

    def _decide(self) -> np.ndarray:
        """Advance the run by one sample, and return the commands that may be sent."""
        try:
            if self.state is State.RUNNING and self._run and not self._run.advance(self._displacement):
                self._settle(self._safety.finish())
            return self._allowed_commands()
        except Exception as error:  # whatever a program or a controller raises closes the valves
            self.stop(_sentence(error))
            return CLOSED

    def _write(self, source: Source, commands: np.ndarray) -> None:
        """Send commands; to a machine only where that is allowed, zero as well."""
        if source.virtual or self._allow_output:
            source.write(commands)

    def _record_samples(self, readings: Sequence[Reading]) -> None:
        try:
            if self._recorder is not None:
                self._recorder.append(readings)
            if self._run is not None:
                self._run.record(readings)
        except OutputError as error:
            self._commands = CLOSED
            self.stop(str(error))
            with contextlib.suppress(OutputError):
                self._end_recording()

    def _allowed_commands(self) -> np.ndarray:
        """Return the commands of the running program within their limits; zero in any other state."""
        if self.state is not State.RUNNING or self._run is None or self._limits is None:
            return CLOSED
        wanted = np.nan_to_num(self._run.step.commands, nan=0.0, posinf=0.0, neginf=0.0)
        if np.all(wanted > 0):
            self.stop("both valves were commanded at once")
            return CLOSED
        return np.clip(wanted, 0.0, self._limits.commands)

    def _take(self, readings: Sequence[Reading]) -> None:
        """Take the newest displacement; stop where there is none, or one outside the limits."""
        assert self._source is not None  # noqa: S101 - called with a source only
        if any(len(reading.values) != len(self._source.signals) for reading in readings):
            raise InputError(f"{self._source.label}: expected a value for each signal in a sample")
        measured = [reading.values[REQUIRED.index(DISPLACEMENT)] for reading in readings]
        valid = [value for value in measured if np.isfinite(value)]
        self._time_s = readings[-1].time_s if readings else self._time_s
        self._silent_s = 0.0 if valid else self._silent_s + self._source.step_s
        self._displacement = valid[-1] if valid else self._displacement
        if self._limits is None or self.state is not State.RUNNING:
            return
        if self._silent_s > self._limits.sensor_silence_s:
            self.stop(f"no displacement for {self._silent_s:.2g} s")
        elif self._limits.is_beyond(self._displacement):
            low, high = self._limits.displacement
            self.stop(f"displacement {self._displacement:.4g} is outside {low:g} to {high:g}")

    def _lose_source(self, reason: str) -> None:
        """Close valves, source and logs; a run is stopped by that, and the reason is kept."""
        source, self._source, self._commands, self._limits = self._source, None, CLOSED, None
        if source is not None:
            with contextlib.suppress(Exception):  # it may be gone
                self._write(source, CLOSED)
            with contextlib.suppress(Exception):
                source.close()
        self._settle(self._safety.disconnect(reason))
        with contextlib.suppress(OutputError):
            self._end_recording()

    def _settle(self, safety: Safety) -> None:
        """Take a state; what moves or records for a run ends with it."""
        self._safety = safety
        if safety.state not in (State.ARMED, State.RUNNING) and self._run is not None:
            run, self._run = self._run, None
            try:
                run.end()
            except OutputError as error:
                self._safety = safety.stop(str(error))

    def _connect(self, request: Request, _: float) -> None:
        connected = self._safety.connect()
        name, options = request.get("source"), request.get("options", {})
        text = self._source_text(str(name), checks.instance(options, dict, "options", "a table"))
        source = make_source(text)
        names = tuple(signal.name for signal in source.signals)
        if names[: len(REQUIRED)] != REQUIRED:
            raise InputError(f"{source.label}: expected the signals {', '.join(REQUIRED)} first, got {names}")
        speed = checks.integer(options.get("speed", 1), "speed", minimum=1)
        if speed > (FASTEST if source.virtual else 1):
            raise InputError(f"speed: expected at most {FASTEST if source.virtual else 1} here, got {speed}")
        limits = self._limits_of(text)
        source.open()
        self._source, self._source_name, self._speed = source, str(name), speed
        self._limits, self._displacement, self._silent_s, self._time_s = limits, np.nan, 0.0, 0.0
        self._settle(connected)

    def _source_text(self, name: str, options: Mapping[str, Any]) -> str:
        if name == "rig":
            return f"rig:{checks.one_of(options.get('rig', 'nominal'), parameter_sets(), 'rig')}"
        if name == "replay":
            return f"replay:{project.inside(self._root, options.get('log'))}"
        return name

    def _limits_of(self, text: str) -> Limits | None:
        if self._limits_file is not None:
            return read_limits(self._limits_file)
        if not text.startswith("rig:"):
            return None
        from hitchid.rig import load_rig

        return limits_of_rig(load_rig(text.removeprefix("rig:")))

    def _disconnect(self, *_: object) -> None:
        self._lose_source("")

    def _arm(self, request: Request, now_s: float) -> None:
        plan = plans.read_plan(request.get("plan"))
        armed = self._safety.arm(is_attended=not plan.unattended, now_s=now_s)
        source = self._source
        assert source is not None  # noqa: S101 - idle has a source
        if not source.can_move:
            raise InputError(f"{source.label}: takes no commands; connect the virtual bench or a machine")
        if not source.virtual and not self._allow_output:
            raise InputError(
                f"{source.label}: is a machine; start hitchid hmi with --allow-output and --limits"
            )
        if self._limits is None:
            raise InputError(f"{source.label}: has no limits; start hitchid hmi with --limits FILE")
        if plan.unattended and not source.virtual:
            raise InputError("unattended: expected false; only the virtual bench runs without its operator")
        if not np.isfinite(self._displacement):
            raise InputError("no displacement was measured yet; check the sensor")
        self._run = Run(self._root, plan, source, self._limits, self._displacement)
        self._safety = armed

    def _start(self, _: Request, now_s: float) -> None:
        running = self._safety.start(now_s)
        assert self._run is not None  # noqa: S101 - armed has a run
        self._run.begin()
        self._silent_s, self._safety = 0.0, running

    def _stop(self, request: Request, _: float) -> None:
        self.stop(str(request.get("reason", "stopped by the operator"))[:200])

    def _reset(self, *_: object) -> None:
        self._settle(self._safety.reset(is_connected=self._source is not None))

    def _set_target(self, request: Request, _: float) -> None:
        target = checks.number(request.get("mm"), "mm")
        if self._run is None or self._run.plan.kind != "drive":
            raise InputError("target: there is no closed loop; arm one first")
        self._run.target.displacement = target

    def _record(self, request: Request, _: float) -> None:
        if not request.get("on"):
            self._end_recording()
        elif self._source is None:
            raise InputError("record: there is no source; connect one first")
        elif self._recorder is None:
            name = f"{datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}.csv"
            self._recorder = Recorder(self._root / project.RECORDINGS / name, self._source.signals)

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
