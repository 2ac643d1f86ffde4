"""Figures of the valve: speed over command, and the dead zone from slow ramps."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from hitchid.logs.record import Record
from hitchid.plots.style import COLOURS, COLUMN_IN, FAINT, INK, decimate, legend_above, styled
from hitchid.validation.valve_map import ValveMap

ONSET_FACTOR = 1.6  # end of a ramp's command axis over the dead zone; chosen


@styled
def valve_map(valve: ValveMap, unit: str, command_unit: str) -> Figure:
    """Return the steady speed of the benchmark over the command, and the speeds measured in the logs.

    Points are medians of equal numbers of samples, lines their 10 % to 90 % quantiles.

    Args:
        valve: speeds of one direction.
        unit, command_unit: of displacement and command.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.7))
    axis = figure.subplots()
    for number, (command, speed) in enumerate(valve.ramps):
        label = "ramps" if number == 0 else None
        axis.plot(*decimate(command, speed), color=FAINT, linewidth=0.7, label=label)
    for speeds in valve.bins:
        axis.plot([speeds.command] * 2, [speeds.low, speeds.high], color=INK, linewidth=0.8)
        axis.plot([speeds.command], [speeds.middle], "o", color=INK, markersize=3.5)
    if valve.bins:
        axis.plot([], [], "o-", color=INK, markersize=3.5, linewidth=0.8, label="tests")
    axis.plot(valve.commands, valve.speeds, color=COLOURS["benchmark"], label="benchmark")
    for zone in valve.dead_zones:
        axis.axvline(zone, color=COLOURS["benchmark"], linestyle=":", label="dead zone")
    axis.set_xlim(1.03 * valve.lowest if valve.signed else 0.5 * valve.dead_zones[0], 1.03 * valve.highest)
    axis.set_xlabel(f"{valve.direction} command / {command_unit}")
    axis.set_ylabel(f"speed / ({unit}/s)")
    legend_above(figure, axis, columns=4)
    return figure


@styled
def dead_zone(
    ramps: Sequence[Record], direction: str, value: float, spread: float | None, unit: str, command_unit: str
) -> Figure:
    """Return displacement over the command of slow ramps, around the command at which motion begins.

    Args:
        ramps: slow ramps of one direction.
        direction: lifting or lowering.
        value, spread: dead zone, and its standard deviation over ramps or None.
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
    axis.set_ylabel(f"travel / {unit}")
    legend_above(figure, axis)
    return figure
