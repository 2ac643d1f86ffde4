"""A campaign that chooses its own tests: a careful start on an unknown machine, then test after test.

The program moves the machine; which test comes next is up to the planner, a process of its own that reads the
logs of the campaign. Everything it does lies in the campaign's folder, so that one that was stopped, by whom
or what ever, goes on from there.
"""

from collections.abc import Collection, Generator, Mapping
from dataclasses import asdict, dataclass
from itertools import count
from typing import Any, Protocol, runtime_checkable

import numpy as np

from hitchid.bench.excitation import two_channel_command
from hitchid.errors import InputError
from hitchid.hmi.plans import MARGIN
from hitchid.hmi.programs import (
    SPEED_WINDOW_S,
    Machine,
    Program,
    Step,
    move,
    settle,
)
from hitchid.hmi.source import CLOSED
from hitchid.logs import DIRECTIONS

REST_S = 3.0  # s of rest, in which noise and drift are measured; chosen
MOST_DRIFT = 0.005  # travels in a second, drift at rest above which a valve does not close; chosen
NOISES = 6.0  # standard deviations of the sensor that count as motion; chosen
LEAST_MOTION = 0.004  # of the travel, that counts as motion; chosen
RAMP_S = 15.0  # s, in which the command of the careful start rises to its limit; chosen
RAMP_TRAVEL = 0.03  # of the travel, at which it has shown that something moves, and ends; chosen
SHORT_WAY = 0.2  # of the travel, up to which a move begins with the valve hardly open; chosen
GUARD_S = 0.3  # s that a test may coast on; chosen: twice that of the bench, whose oil springs are soft
RAMP_TAIL_S = 0.5  # s at the end of a ramp, over which its speed is taken; chosen
SAMPLES_OF_SPEED = 3  # fewest samples of a speed; chosen


@dataclass(frozen=True)
class Start:
    """What the careful start has shown of a machine, lifting and lowering.

    Attributes:
        signs: +1 where the displacement grows with the command, −1 where it falls; 0 where nothing moved.
        onsets: commands from which the piston moves.
        speeds: speed for a command beyond the onset, in the displacement's unit a second and the command's.
        noise: standard deviation of the displacement at rest.
        drift: of the displacement at rest, in its unit a second.
    """

    signs: tuple[int, int]
    onsets: tuple[float, float]
    speeds: tuple[float, float]
    noise: float
    drift: float

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> "Start":
        """Return it from content of JSON; raises KeyError, TypeError or ValueError where that is another."""

        def pair(name: str, kind: type) -> tuple[Any, Any]:
            first, second = map(kind, content[name])
            return first, second

        signs, onsets, speeds = pair("signs", int), pair("onsets", float), pair("speeds", float)
        numbers = (*onsets, *speeds, float(content["noise"]), float(content["drift"]))
        if not (set(signs) <= {-1, 0, 1} and signs[0] != signs[1] and np.isfinite(numbers).all()):
            raise ValueError("signs, onsets or speeds out of range")
        return cls(signs, onsets, speeds, numbers[-2], numbers[-1])

    @property
    def directions(self) -> tuple[str, ...]:
        """Directions that move."""
        return tuple(name for name, sign in zip(DIRECTIONS, self.signs, strict=True) if sign)


@runtime_checkable
class Planner(Protocol):
    """Who chooses the tests; no call may block."""

    def ask(self, state: Mapping[str, Any]) -> None:
        """Ask for the next test, after the logs that were handed over to the disk before."""
        ...

    def answer(self) -> Mapping[str, Any] | None:
        """Return the answer to the last question; None while there is none.

        Raises:
            HitchError: the planner failed.
        """
        ...


def adaptive(
    displacement: float,
    machine: Machine,
    planner: Planner,
    progress: Mapping[str, Any] | None = None,
    taken: Collection[str] = (),
) -> Program:
    """Yield the steps of a campaign that chooses its own tests, until the planner ends it.

    Args:
        displacement: at which it begins.
        machine: that is moved.
        planner: that chooses the tests.
        progress: of a campaign that goes on.
        taken: names of logs that there are already.

    Raises:
        InputError: the machine drifts at rest, or nothing moves.
    """
    clock = _Clock(60 * float((progress or {}).get("minutes", 0.0)))
    shown = (progress or {}).get("start")
    program = _campaign(displacement, machine, planner, Start.of(shown) if shown else None, clock, taken)
    measured = None
    while True:
        try:
            step = next(program) if measured is None else program.send(measured)
        except StopIteration:
            return
        measured = yield step
        if step.phase != "planning" or not machine.is_virtual:
            clock.seconds += machine.step_s


@dataclass
class _Clock:
    """Bench time that was spent, s."""

    seconds: float


def _campaign(
    displacement: float,
    machine: Machine,
    planner: Planner,
    start: Start | None,
    clock: _Clock,
    taken: Collection[str],
) -> Program:
    if start is None:
        start, displacement = yield from _careful_start(displacement, machine, taken)
    window_s = max(SPEED_WINDOW_S, SAMPLES_OF_SPEED * machine.interval_s)
    # A direction that did not move is the other one turned round, for moves: it is never commanded.
    signs = tuple(sign or -other for sign, other in zip(start.signs, start.signs[::-1], strict=True))
    while True:
        # A step without a log first: the log of the last test is closed by it, and then the planner asked.
        measured = yield Step(CLOSED, "planning")
        displacement = measured if np.isfinite(measured) else displacement
        planner.ask({"minutes": clock.seconds / 60, "displacement": displacement, "start": asdict(start)})
        while (test := planner.answer()) is None:
            measured = yield Step(CLOSED, "planning")
            displacement = measured if np.isfinite(measured) else displacement
        if machine.is_virtual:  # whose clock may stand still meanwhile, or run twenty times as fast
            clock.seconds += float(test["seconds"])
        if test["stop"]:
            return
        if test["begin"] is None:
            displacement = yield from settle(displacement, machine.step_s)
        else:
            is_long = abs(float(test["begin"]) - displacement) > SHORT_WAY * machine.limits.travel
            lifting, lowering = test.get("onsets", start.onsets) if is_long else start.onsets
            moved = move(
                displacement,
                float(test["begin"]),
                machine.limits,
                machine.step_s,
                signs=signs,  # type: ignore[arg-type]
                onsets=(float(lifting), float(lowering)),
                window_s=window_s,
                log=str(test["move"]),
            )
            displacement = yield from moved
        repeats = max(1, round(machine.interval_s / machine.step_s))
        commands = np.repeat(np.asarray(test["command"], float), repeats)
        rows = two_channel_command(str(test["direction"]), commands)
        most = float(test.get("travel", np.inf))
        measured_rows = yield from guarded(displacement, rows, str(test["log"]), machine, window_s, most)
        displacement = _last(measured_rows, displacement)


def guarded(
    displacement: float,
    commands: np.ndarray,
    log: str,
    machine: Machine,
    window_s: float,
    travel: float = np.inf,
) -> Generator[Step, float, list[float]]:
    """Yield the steps of a test, shape [N, 2], and return the displacement at each of its samples.

    It ends early where the piston would coast into the margin before an end of travel that it approaches,
    whichever way a command drives it, or has gone as far as `travel`.
    """
    low, high = machine.limits.displacement
    margin = MARGIN * machine.limits.travel
    window, measured, latest = max(1, round(window_s / machine.step_s)), [displacement], displacement
    valid = [displacement] * (window + 1)
    for sample, row in enumerate(commands):
        left_s = (len(commands) - sample) * machine.step_s
        displacement = yield Step(row, "test", log, left_s)
        measured.append(displacement)
        latest = displacement if np.isfinite(displacement) else latest
        valid = [*valid[1:], latest]
        coast = (valid[-1] - valid[0]) / (window * machine.step_s) * GUARD_S
        ahead = latest + coast
        # Of the end that it moves to: a test that begins near the other one must be able to leave it.
        if abs(latest - measured[0]) > travel:
            break
        has_moved = abs(latest - measured[0]) > LEAST_MOTION * machine.limits.travel  # more than noise
        if has_moved and ((coast > 0 and ahead > high - margin) or (coast < 0 and ahead < low + margin)):
            break
    return measured[:-1]  # the last one was measured after the last command, which is no sample of the log


def _careful_start(
    displacement: float, machine: Machine, taken: Collection[str]
) -> Generator[Step, float, tuple[Start, float]]:
    """Yield a rest, then a ramp of each direction until something moves; return what they have shown."""
    limits, step_s = machine.limits, machine.step_s
    names = ("start/rest", *(f"start/{direction}" for direction in DIRECTIONS))
    fresh = {name: _fresh(name, taken) for name in names}
    rest = []
    for remaining in range(round(REST_S / step_s), 0, -1):
        measured_one = yield Step(CLOSED, "rest", fresh["start/rest"], remaining * step_s)
        rest.append(measured_one)
    at_rest = np.array(rest)[np.isfinite(rest)]
    if at_rest.size < SAMPLES_OF_SPEED:
        raise InputError("no displacement is measured at rest; check the sensor")
    time_s = step_s * np.arange(at_rest.size)
    drift = float(np.polyfit(time_s, at_rest, 1)[0])
    noise = float(np.std(at_rest - np.polyval(np.polyfit(time_s, at_rest, 1), time_s)))
    displacement = float(np.median(at_rest[-SAMPLES_OF_SPEED:]))
    unit = next(signal.unit for signal in machine.signals if signal.name == "displacement")
    if abs(drift) > MOST_DRIFT * limits.travel:
        raise InputError(
            f"the machine moves at {drift:.3g} {unit}/s without a command; close its valves at a command of "
            "zero (the neutral of a valve need not be at zero), or wait until it rests"
        )
    threshold = max(NOISES * noise, LEAST_MOTION * limits.travel)
    signs, onsets, speeds = [0, 0], [0.0, 0.0], [0.0, 0.0]
    low, high = limits.displacement
    # Away from the nearer end first, then the other way, and once more what stood at a stop the first time.
    first = 0 if displacement - low <= high - displacement else 1
    tries = [0, 0]
    for channel in (first, 1 - first, first):
        if signs[channel]:
            continue
        tries[channel] += 1
        direction = DIRECTIONS[channel]
        command = np.linspace(0.0, limits.commands[channel], round(RAMP_S / step_s) + 1)
        log = f"{fresh[f'start/{direction}']}{'-again' if tries[channel] > 1 else ''}"
        begin, measured, onset = displacement, [], 0.0
        for sample, value in enumerate(command):
            row = CLOSED.copy()
            row[channel] = value
            displacement = yield Step(row, "ramp", log, (len(command) - sample) * step_s)
            measured.append(displacement)
            moved = abs(displacement - begin)  # of a displacement that is missing: not moved
            onset = onset or (value if moved > threshold else 0.0)
            # An end of travel that it approaches ends it too, whichever way it is.
            room = low + MARGIN * limits.travel < displacement < high - MARGIN * limits.travel
            if moved > RAMP_TRAVEL * limits.travel or (onset and not room and moved > 2 * threshold):
                break
        displacement = _last(measured, begin)
        if onset:
            signs[channel] = 1 if displacement > begin else -1
            tail = min(round(RAMP_TAIL_S / step_s), len(measured) // 2)
            travelled = abs(_last(measured, begin) - measured[-tail - 1])
            excess = max(
                float(command[len(measured) - 1 - tail // 2]) - onset, 0.02 * limits.commands[channel]
            )
            onsets[channel], speeds[channel] = float(onset), travelled / (tail * step_s * excess)
        displacement = yield from settle(displacement, step_s)
    if not any(signs):
        raise InputError(
            f"nothing moved up to the limits of the commands, {limits.lifting_command:g} and "
            f"{limits.lowering_command:g} {limits.command_unit}; check supply and wiring, or raise the limits"
        )
    if signs[0] == signs[1]:
        way = "up" if signs[0] > 0 else "down"
        raise InputError(f"both commands move the displacement {way}; check which command drives which valve")
    return Start(tuple(signs), tuple(onsets), tuple(speeds), noise, drift), displacement  # type: ignore[arg-type]


def _fresh(prefix: str, taken: Collection[str]) -> str:
    """Return the first name of a prefix that is not taken."""
    return next(name for number in count(1) if (name := f"{prefix}-{number:02d}") not in taken)


def _last(measured: list[float], otherwise: float) -> float:
    """Return the last displacement that was measured."""
    valid = [value for value in measured if np.isfinite(value)]
    return float(valid[-1]) if valid else otherwise
