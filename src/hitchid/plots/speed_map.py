"""Speed map: steady speed over command with bands, measured speeds and dead zone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from hitchid.plots.style import COLOURS, FAINT, INK

LINE_STYLES = (("one_step", "v", "--"), ("benchmark", "s", "-"), ("greybox", "^", "-."))
BAND_ALPHA = 0.22  # opacity of a band; chosen
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
