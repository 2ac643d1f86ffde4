"""Speed over command: of the benchmark, of tests while their command was constant, and of slow ramps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from hitchid._support.precision import double_precision
from hitchid.handover.responses import settling_s
from hitchid.logs.record import COMMAND, DISPLACEMENT, Record
from hitchid.model import Channel

LEVELS = 24  # commands of the benchmark's curve; all values chosen
SETTLED_S, END_S = 3.0, 0.5  # the benchmark's speed: mean over the last 0.5 s of 3 s or more at one command
# A test's speed is taken over 0.12 s, of a command that has been constant for 0.25 s and four lags: by then
# a speed with one lag has reached 98 %.
STEADY_S, SLOPE_S, LAGS = 0.25, 0.12, 4.0
RAMP_S = 0.5  # window over which the speed of a ramp is taken
NOISE = 0.02  # share of the command's range below which a change is noise
BINS, MIN_SAMPLES_PER_BIN = 12, 8  # largest number of bins, smallest number of samples in each


@dataclass(frozen=True)
class SpeedBin:
    """Speeds of tests at similar commands: 10 %, 50 % and 90 % quantiles at the median command."""

    command: float
    low: float
    middle: float
    high: float


@dataclass(frozen=True)
class ValveMap:
    """Speed over command of one direction, in the model's units.

    Attributes:
        direction: lifting or lowering.
        commands, speeds: steady speed of the benchmark at each command, shape [L].
        bins: speeds of the tests while their command was constant.
        ramps: command and speed of each slow ramp while it rises, two arrays of shape [M].
        dead_zones: commands at which motion begins; two where the commands have both signs.
        lowest, highest: smallest and largest command of the tests.
    """

    direction: str
    commands: np.ndarray
    speeds: np.ndarray
    bins: tuple[SpeedBin, ...]
    ramps: tuple[tuple[np.ndarray, np.ndarray], ...]
    dead_zones: tuple[float, ...]
    lowest: float
    highest: float

    @property
    def signed(self) -> bool:
        """Whether the commands of the tests have both signs."""
        return len(self.dead_zones) > 1


def valve_map(channel: Channel, tests: Sequence[Record], ramps: Sequence[Record]) -> ValveMap:
    """Return the steady speed of the benchmark over the command, and the speeds measured in the logs.

    Tests: slope of the displacement over 0.12 s once the command has been constant for 0.25 s, and for the
    dead time and four lags of the benchmark, in bins of equal numbers of samples. Ramps: slope over 0.5 s.

    Args:
        channel: of the model.
        tests: single-direction tests on the model's clock and in its units.
        ramps: slow ramps, the same.
    """
    commands = [test.command(channel.direction) for test in tests]
    lowest, highest = float(min(map(np.min, commands))), float(max(map(np.max, commands)))
    signed = lowest < -channel.dead_zone
    levels = np.linspace(lowest if signed else 0.0, highest, LEVELS)
    return ValveMap(
        direction=channel.direction,
        commands=levels,
        speeds=_model_speed(channel, tests, levels),
        bins=_speed_bins(*_steady_speeds(tests, channel)),
        ramps=tuple(_ramp_speed(ramp, channel) for ramp in ramps),
        dead_zones=(-channel.dead_zone, channel.dead_zone) if signed else (channel.dead_zone,),
        lowest=lowest,
        highest=highest,
    )


def _speed_bins(commands: np.ndarray, speeds: np.ndarray) -> tuple[SpeedBin, ...]:
    if commands.size < MIN_SAMPLES_PER_BIN:
        return ()
    by_command = np.array_split(np.argsort(commands), min(BINS, commands.size // MIN_SAMPLES_PER_BIN))
    return tuple(
        SpeedBin(float(np.median(commands[inside])), *np.quantile(speeds[inside], [0.1, 0.5, 0.9]).tolist())
        for inside in by_command
    )


def _steady_speeds(tests: Sequence[Record], channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Return commands and speeds, shape [M], at samples preceded by a constant command and settled speed."""
    commands, speeds = [], []
    steady_s = max(STEADY_S, settling_s(channel, LAGS) + SLOPE_S)
    for test in tests:
        command = test.command(channel.direction)
        steady_samples, slope_samples = (max(3, round(span / test.step_s)) for span in (steady_s, SLOPE_S))
        changed = np.abs(np.diff(command, prepend=command[:1])) > NOISE * np.ptp(command)
        last_change = np.maximum.accumulate(np.where(changed, np.arange(command.size), 0))
        sample_indices = np.flatnonzero(np.arange(command.size) - last_change == steady_samples)
        commands.append(command[sample_indices])
        before = test.displacement[sample_indices - slope_samples]
        displacement_change = channel.sign * (test.displacement[sample_indices] - before)
        speeds.append(displacement_change / (slope_samples * test.step_s))
    return np.concatenate(commands), np.concatenate(speeds)


def _ramp_speed(ramp: Record, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Return command and speed while a ramp rises, each of shape [M]."""
    command = ramp.command(channel.direction)
    rising = int(np.argmax(command)) + 1
    window = 2 * max(1, round(0.5 * RAMP_S / ramp.step_s)) + 1
    if rising < 2 * window:
        return np.empty(0), np.empty(0)
    speed = np.asarray(savgol_filter(ramp.displacement[:rising], window, 1, deriv=1, delta=ramp.step_s))
    middle = slice(window // 2, rising - window // 2)
    return command[middle], channel.sign * speed[middle]


@double_precision
def _model_speed(channel: Channel, tests: Sequence[Record], levels: np.ndarray) -> np.ndarray:
    """Return the benchmark's mean speed over the last 0.5 s at each command, shape [L].

    It lasts 3 s, or the dead time, four lags and 0.5 s where that is more.
    """
    step_s = tests[0].step_s
    count = max(8, round(max(SETTLED_S, settling_s(channel, LAGS) + END_S) / step_s))
    start = float(np.median([test.displacement[0] for test in tests]))
    first_sample = tests[0].slice(0, 1)
    records = [
        Record(
            f"{level:g}",
            step_s,
            {role: np.full(count, rows[0]) for role, rows in first_sample.signals.items()}
            | {DISPLACEMENT: np.full(count, start), COMMAND[channel.direction]: np.full(count, level)},
            first_sample.units,
        )
        for level in levels
    ]
    batch = channel.batch(records, [start] * len(records))
    travel = np.asarray(channel.benchmark.travel(batch))[:, :count]
    end_samples = max(2, round(END_S / step_s))
    return (travel[:, -1] - travel[:, -end_samples]) / (step_s * (end_samples - 1))
