"""Speed map: steady speed over command with bands, measured speeds and dead zone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from hitchid.plots.style import COLOURS, FAINT, INK, logarithmic

# Responses of a model with bands: to command steps over time, and over frequency.

BAND_ALPHA = 0.22  # opacity of a band; chosen
LEVEL_COLOURS = tuple(COLOURS[name] for name in ("one_step", "benchmark", "greybox", "lstm", "narx", "arx"))
"""Colours of the levels of a command, from the first."""
DECIBELS_PER_TICK, DEGREES_PER_TICK = 20.0, 90.0  # or whole multiples, a decade and a quarter turn
MAX_TICKS = 8  # on an axis; chosen


class BandedCurve(NamedTuple):
    """A curve with its band.

    Attributes:
        label: for the legend; None for none.
        colour: as matplotlib takes it.
        x: shape [N].
        y: values, lower and upper end of the band, shape [N] each; the ends are None for no band.
    """

    label: str | None
    colour: str
    x: np.ndarray
    y: tuple[np.ndarray, np.ndarray | None, np.ndarray | None]


def draw_curves(axes: Axes, curves: Sequence[BandedCurve], x_label: str, y_label: str) -> None:
    """Draw curves with their bands; the labels name quantity and unit."""
    for label, colour, x, (values, lower, upper) in curves:
        if lower is not None and upper is not None:
            axes.fill_between(x, lower, upper, color=colour, alpha=BAND_ALPHA, linewidth=0)
        axes.plot(x, values, color=colour, label=label)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)


def draw_bode(
    magnitude_axes: Axes,
    phase_axes: Axes,
    magnitudes: Sequence[BandedCurve],
    phases: Sequence[BandedCurve],
    *,
    unit: str,
) -> None:
    """Draw a Bode diagram.

    Args:
        magnitude_axes, phase_axes: to draw into.
        magnitudes: over frequency in Hz, in dB.
        phases: over frequency in Hz, in degrees.
        unit: in which 0 dB is one.
    """
    draw_curves(magnitude_axes, magnitudes, "", f"magnitude (re 1 {unit}) / dB")
    draw_curves(phase_axes, [phase._replace(label=None) for phase in phases], "frequency / Hz", "phase / °")
    for axes, spacing in ((magnitude_axes, DECIBELS_PER_TICK), (phase_axes, DEGREES_PER_TICK)):
        logarithmic(axes.xaxis)
        low, high = axes.get_ylim()
        if high - low >= spacing:
            axes.yaxis.set_major_locator(MultipleLocator(spacing * -(-(high - low) // (MAX_TICKS * spacing))))


LINE_STYLES = (("one_step", "v", "--"), ("benchmark", "s", "-"), ("greybox", "^", "-."))
HEADROOM = 1.5  # top of the axis over the fastest speed; chosen


class SpeedCurve(NamedTuple):
    """Steady speed over command.

    Attributes:
        label: of the curve: its load, or the model.
        commands, speeds: shape [Q].
        lower, upper: ends of the band, infinite where open, shape [Q]; None for no band.
    """

    label: str
    commands: np.ndarray
    speeds: np.ndarray
    lower: np.ndarray | None = None
    upper: np.ndarray | None = None


def draw_speed_map(
    axes: Axes,
    curves: Sequence[SpeedCurve],
    measured: Sequence[tuple[float, float]],
    *,
    command_unit: str,
    speed_unit: str,
) -> None:
    """Draw speed over command for each load, with bands, and the mean speeds measured in tests.

    Points of curves with a band are operating points; a curve without one is drawn without points.

    Args:
        axes: to draw into.
        curves: at most three: one, or one for each load; an open upper end extends to the edge.
        measured: command and speed of each measured point.
        command_unit, speed_unit: of the axes.
    """
    measured_speeds = [speed for _, speed in measured]
    fastest = max([float(curve.speeds.max()) for curve in curves] + measured_speeds)
    highest = HEADROOM * fastest or 1.0
    styles = LINE_STYLES if len(curves) > 1 else LINE_STYLES[1:2]
    for curve, (colour, marker, dashes) in zip(curves, styles, strict=False):
        shade = COLOURS[colour]
        if curve.lower is None or curve.upper is None:
            axes.plot(curve.commands, curve.speeds, label=curve.label, color=shade)
            continue
        upper = np.where(np.isfinite(curve.upper), curve.upper, highest)
        if curve.commands.size == 1:
            axes.vlines(curve.commands, curve.lower, upper, alpha=BAND_ALPHA, linewidth=4, color=shade)
        axes.fill_between(curve.commands, curve.lower, upper, alpha=BAND_ALPHA, linewidth=0, color=shade)
        axes.plot(
            curve.commands, curve.speeds, dashes, marker=marker, markersize=3, label=curve.label, color=shade
        )
    if measured:
        axes.plot(
            [command for command, _ in measured],
            measured_speeds,
            "o",
            color=INK,
            markersize=3,
            fillstyle="none",
            label="measured",
        )
    axes.set_ylim(min(0.0, *measured_speeds, 0.0), highest)
    axes.set_xlabel(f"command / {command_unit}")
    axes.set_ylabel(f"speed / ({speed_unit})")


def draw_dead_zone(axes: Axes, value: float, lower: float | None, upper: float | None) -> None:
    """Mark a dead zone on the command's axis, with its interval where both ends are known."""
    axes.axvline(value, color=FAINT, linestyle=":", label="dead zone")
    if lower is not None and upper is not None:
        axes.axvspan(lower, upper, color=FAINT, alpha=BAND_ALPHA, linewidth=0)
