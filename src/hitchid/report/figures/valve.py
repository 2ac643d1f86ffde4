"""The valve as tests show it: speed over command, and where a slow ramp sets the piston moving."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import savgol_filter

from hitchid._support.precision import double_precision
from hitchid.data.record import Record
from hitchid.model import Channel
from hitchid.report.figures.style import COLOURS, COLUMN_IN, FAINT, INK, decimate, legend_above, styled

LEVELS, SETTLED_S, END_S = 24, 3.0, 0.5
STEADY_S, SLOPE_S, RAMP_S, NOISE = 0.25, 0.12, 0.5, 0.02
BINS, MIN_SAMPLES_PER_BIN = 12, 8
ONSET_FACTOR = 1.6


@styled
def valve_map(
    channel: Channel, tests: Sequence[Record], ramps: Sequence[Record], unit: str, command_unit: str
) -> Figure:
    """Return the speed the benchmark settles at over the command, and the speeds that logs show.

    From tests: the slope over the end of a quarter of a second in which the command has stood; points are
    medians of equal numbers of samples, lines hold 80 % of them. From ramps: the slope over half a second.

    Args:
        channel: of the model.
        tests: single-direction tests on the model's clock and in its units.
        ramps: slow ramps, the same.
        unit, command_unit: of displacement and command.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.7))
    axis = figure.subplots()
    for number, ramp in enumerate(ramps):
        command, speed = _ramp_speed(ramp, channel)
        label = "ramps" if number == 0 else None
        axis.plot(*decimate(command, speed), color=FAINT, linewidth=0.7, label=label)
    commands, speeds = _steady_speeds(tests, channel)
    if commands.size >= MIN_SAMPLES_PER_BIN:
        for bin_indices in np.array_split(
            np.argsort(commands), min(BINS, commands.size // MIN_SAMPLES_PER_BIN)
        ):
            low, middle, high = np.quantile(speeds[bin_indices], [0.1, 0.5, 0.9])
            centre = float(np.median(commands[bin_indices]))
            axis.plot([centre, centre], [low, high], color=INK, linewidth=0.8)
            axis.plot([centre], [middle], "o", color=INK, markersize=3.5)
        axis.plot([], [], "o-", color=INK, markersize=3.5, linewidth=0.8, label="tests")
    command_ranges = [
        (float(c.min()), float(c.max())) for c in (test.command(channel.direction) for test in tests)
    ]
    lowest, largest = min(low for low, _ in command_ranges), max(high for _, high in command_ranges)
    signed = lowest < -channel.dead_zone
    levels = np.linspace(lowest if signed else 0.0, largest, LEVELS)
    axis.plot(levels, _model_speed(channel, tests, levels), color=COLOURS["benchmark"], label="benchmark")
    for zone in (-channel.dead_zone, channel.dead_zone) if signed else (channel.dead_zone,):
        axis.axvline(zone, color=COLOURS["benchmark"], linestyle=":", label="dead zone")
    axis.set_xlim(1.03 * lowest if signed else 0.5 * channel.dead_zone, 1.03 * largest)
    axis.set_xlabel(f"{channel.direction} command / {command_unit}")
    axis.set_ylabel(f"speed / ({unit}/s)")
    legend_above(figure, axis, columns=4)
    return figure


def _steady_speeds(tests: Sequence[Record], channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Return commands and speeds, shape [M], at samples before which the command has stood long enough."""
    commands, speeds = [], []
    for test in tests:
        command = test.command(channel.direction)
        steady_samples, slope_samples = (max(3, round(span / test.step_s)) for span in (STEADY_S, SLOPE_S))
        last_change = np.maximum.accumulate(np.where(_command_changes(command), np.arange(command.size), 0))
        sample_indices = np.flatnonzero(np.arange(command.size) - last_change == steady_samples)
        commands.append(command[sample_indices])
        displacement_change = channel.sign * (
            test.displacement[sample_indices] - test.displacement[sample_indices - slope_samples]
        )
        speeds.append(displacement_change / (slope_samples * test.step_s))
    return np.concatenate(commands), np.concatenate(speeds)


def _command_changes(command: np.ndarray) -> np.ndarray:
    """Tell at which samples a command is no longer that of the sample before, noise aside."""
    return np.abs(np.diff(command, prepend=command[:1])) > NOISE * np.ptp(command)


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
    """Return the speed the benchmark has half a second before the end of three seconds at each command."""
    step_s = tests[0].step_s
    count = max(8, round(SETTLED_S / step_s))
    start = float(np.median([test.displacement[0] for test in tests]))
    first_sample = tests[0].slice(0, 1)
    records = [
        Record(
            f"{level:g}",
            step_s,
            {role: np.full(count, rows[0]) for role, rows in first_sample.signals.items()}
            | {"displacement": np.full(count, start), f"{channel.direction}_command": np.full(count, level)},
            first_sample.units,
        )
        for level in levels
    ]
    batch = channel.batch(records, [start] * len(records))
    travel = np.asarray(channel.benchmark.travel(batch))[:, :count]
    end_samples = max(2, round(END_S / step_s))
    return (travel[:, -1] - travel[:, -end_samples]) / (step_s * (end_samples - 1))


@styled
def dead_zone(
    ramps: Sequence[Record], direction: str, value: float, spread: float | None, unit: str, command_unit: str
) -> Figure:
    """Return the way of the piston over the command of slow ramps, around the command that sets it moving.

    Args:
        ramps: slow ramps of one direction.
        direction: the direction.
        value, spread: dead zone and its standard deviation over ramps, None where that is not known.
        unit, command_unit: of displacement and command.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.3))
    axis = figure.subplots()
    highest = 0.0
    for ramp in ramps:
        command = ramp.command(direction)
        rising = slice(0, int(np.argmax(command)) + 1)
        near = command[rising] <= ONSET_FACTOR * value
        travel = np.abs(ramp.displacement[rising] - ramp.displacement[0])
        axis.plot(*decimate(command[rising][near], travel[near]), color=INK, linewidth=0.8)
        highest = max(highest, float(travel[near].max(initial=0.0)))
    axis.axvline(value, color=COLOURS["benchmark"], label="dead zone")
    if spread:
        axis.axvspan(value - spread, value + spread, color=COLOURS["benchmark"], alpha=0.25, linewidth=0)
    axis.set_xlim(0.4 * value, ONSET_FACTOR * value)
    axis.set_ylim(-0.02 * highest, 1.05 * highest or 1.0)
    axis.set_xlabel(f"{direction} command / {command_unit}")
    axis.set_ylabel(f"way of the piston / {unit}")
    legend_above(figure, axis)
    return figure
