"""Machines of a fleet beside each other: intervals, ellipses of errors, verdicts, speed over command."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes

from hitchid.plots.style import COLOURS, COMPARED, FAINT, GRID, INK

LOWER, ALIKE, HIGHER, ABSENT, FAILED = -1, 0, 1, 2, 3
"""Verdicts on one parameter of one machine: beside the others, not compared, not identified."""
VERDICTS = {
    HIGHER: ("higher than the others", "^", COLOURS["benchmark"], 28.0),
    LOWER: ("lower than the others", "v", COLOURS["one_step"], 28.0),
    ALIKE: ("like the others", "o", FAINT, 5.0),
    ABSENT: ("not compared", "_", FAINT, 12.0),
    FAILED: ("not identified", "x", INK, 14.0),
}
"""Verdict to its label, marker, colour and area in points²: distinguished without colours, too."""
INTERVAL_WIDTH, POINT_SIZE = 0.9, 3.0  # of a machine's interval and its value, points; chosen
OUTER, INNER = (0.025, 0.975), (0.25, 0.75)  # quantiles of the machines that are drawn as one row
CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 73)), np.sin(np.linspace(0, 2 * np.pi, 73))])
RADIUS = float(np.sqrt(-2 * np.log(0.05)))  # of the ellipse that contains 95 % of a normal distribution
LINE_WIDTH = 0.6  # of the speed of one of many machines, points; chosen
OPAQUE_LINES, LEAST_ALPHA = 10, 0.2  # lines that are drawn opaque, and the opacity of one of many; chosen
STYLES = tuple(COMPARED.values())  # of machines that are pointed out; further ones are drawn alike
FURTHER = ("ink", (1.0, 1.0), "")
NAME_SHARE = (0.35, 0.06)  # width and height of a name, shares of the axes; chosen: no name covers another


class SpeedLine(NamedTuple):
    """Steady speed over command of one machine that is pointed out.

    Attributes:
        label: its name.
        gain, dead_zone: its parameters.
        style: number of its colour and dashes, of `STYLES`; larger ones have those of all further machines.
    """

    label: str
    gain: float
    dead_zone: float
    style: int


def draw_machine_intervals(
    axes: Axes,
    values: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    verdicts: Int[np.ndarray, " n"],
) -> None:
    """Draw the value of each machine with its interval, the first one at the top.

    Args:
        axes: to draw into.
        values, lower, upper: of each machine, NaN where missing, shape [N].
        verdicts: of each machine, `HIGHER`, `LOWER` or another one, shape [N].
    """
    rows = np.arange(len(values))
    for verdict in (ALIKE, LOWER, HIGHER):
        _, marker, colour, _ = VERDICTS[verdict]
        outlying = verdict in (LOWER, HIGHER)
        of_it = verdicts == verdict if outlying else ~np.isin(verdicts, (LOWER, HIGHER))
        shade = colour if outlying else INK
        axes.hlines(rows[of_it], lower[of_it], upper[of_it], color=shade, linewidth=INTERVAL_WIDTH)
        size = POINT_SIZE * (1.6 if outlying else 1.0)
        axes.plot(values[of_it], rows[of_it], marker, color=shade, markersize=size, linestyle="none")


def draw_distribution(
    axes: Axes, mean: float, mean_interval: tuple[float, float], prediction_interval: tuple[float, float]
) -> None:
    """Draw mean and prediction interval over machines across all rows; nothing where they are NaN."""
    if np.isnan(mean):
        return
    axes.axvspan(*prediction_interval, color=GRID, alpha=0.6, linewidth=0, zorder=0)
    axes.axvspan(*mean_interval, color=FAINT, alpha=0.45, linewidth=0, zorder=0.1)
    axes.axvline(mean, color=INK, linewidth=0.7, zorder=0.2)


def draw_quantiles(axes: Axes, values: Float[np.ndarray, " n"], row: int) -> None:
    """Draw 95 % and half of some values as a thin and a thick line, and their median, in one row."""
    known = values[~np.isnan(values)]
    if not known.size:
        return
    (low, high), (first, third) = np.quantile(known, OUTER), np.quantile(known, INNER)
    axes.hlines([row], low, high, color=INK, linewidth=INTERVAL_WIDTH)
    axes.hlines([row], first, third, color=INK, linewidth=4 * INTERVAL_WIDTH)
    axes.plot([np.median(known)], [row], "|", color=INK, markersize=9)


def ellipse(
    centre: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "2 k"]:
    """Return the curve that contains 95 % of a normal distribution, which may have no spread in an axis."""
    spread, axes = np.linalg.eigh(covariance)
    return centre[:, None] + axes @ (RADIUS * np.sqrt(np.maximum(spread, 0.0))[:, None] * CIRCLE)


def draw_ellipses(axes: Axes, curves: Sequence[Float[np.ndarray, "2 k"]], colour: str, width: float) -> None:
    """Draw closed curves, shape [2, K] each, in one colour and width in points."""
    from matplotlib.collections import LineCollection

    lines = LineCollection([curve.T for curve in curves], colors=colour, linewidths=width)
    axes.add_collection(lines)
    axes.autoscale_view()


def draw_machine_points(
    axes: Axes,
    x: Float[np.ndarray, " n"],
    y: Float[np.ndarray, " n"],
    outlying: Bool[np.ndarray, " n"],
    names: Sequence[str],
) -> None:
    """Draw a point for each machine; those that stand out are diamonds with their name.

    Args:
        axes: to draw into.
        x, y: of each machine, shape [N].
        outlying: whether it stands out, shape [N].
        names: of each machine; an empty one is not written.
    """
    for of_it, marker, colour, size, label in (
        (~outlying, "o", FAINT, 2.5, "machine"),
        (outlying, "D", COLOURS["benchmark"], 3.5, "stands out"),
    ):
        if of_it.any():
            axes.plot(x[of_it], y[of_it], marker, color=colour, markersize=size, label=label)
    for index in _apart(x, y, np.flatnonzero([bool(name) for name in names])):
        axes.annotate(
            names[index], (x[index], y[index]), xytext=(4, 3), textcoords="offset points", fontsize=6.5
        )


def _apart(x: np.ndarray, y: np.ndarray, candidates: Int[np.ndarray, " k"]) -> list[int]:
    """Return the points whose names do not cover each other, the first ones where they would."""
    place = np.stack([x / (np.ptp(x) or 1.0), y / (np.ptp(y) or 1.0)])
    chosen: list[int] = []
    for index in candidates.tolist():
        distances = np.abs(place[:, chosen] - place[:, [index]])
        if not np.any(np.all(distances < np.array(NAME_SHARE)[:, None], axis=0)):
            chosen.append(index)
    return chosen


def draw_verdicts(axes: Axes, verdicts: Int[np.ndarray, "n p"]) -> None:
    """Draw the verdict on each parameter of each machine as a grid, the first machine at the top."""
    for verdict, (label, marker, colour, area) in VERDICTS.items():
        rows, columns = np.nonzero(verdicts == verdict)
        if rows.size:
            axes.scatter(columns, rows, s=area, marker=marker, color=colour, label=label, linewidths=1.0)
    axes.set_xlim(-0.5, verdicts.shape[1] - 0.5)
    axes.set_ylim(verdicts.shape[0] - 0.5, -0.5)


def draw_speed_fan(
    axes: Axes,
    gains: Float[np.ndarray, " n"],
    dead_zones: Float[np.ndarray, " n"],
    highest_command: float,
    outlying: Sequence[SpeedLine],
) -> None:
    """Draw gain · (command − dead zone) of all machines in light lines, and of some in lines of their own.

    Args:
        axes: to draw into.
        gains, dead_zones: of each machine, shape [N].
        highest_command: end of the command's axis.
        outlying: pointed out, above the others.
    """
    from matplotlib.collections import LineCollection

    def line(gain: float, dead_zone: float) -> list[tuple[float, float]]:
        end = max(highest_command, dead_zone)
        return [(0.0, 0.0), (dead_zone, 0.0), (end, gain * (end - dead_zone))]

    many = [line(*pair) for pair in zip(gains.tolist(), dead_zones.tolist(), strict=True)]
    opacity = float(np.clip(OPAQUE_LINES / max(1, len(many)), LEAST_ALPHA, 1.0))
    axes.add_collection(
        LineCollection(many, colors=FAINT, linewidths=LINE_WIDTH, alpha=opacity, label="all machines")
    )
    for each in outlying:
        is_further = each.style >= len(STYLES)
        colour, dashes, _ = FURTHER if is_further else STYLES[each.style]
        label = "further ones that stand out" if is_further else each.label
        x, y = zip(*line(each.gain, each.dead_zone), strict=True)
        axes.plot(x, y, color=COLOURS[colour], dashes=dashes, label=label)
    axes.autoscale_view()
    axes.set_xlim(0.0, highest_command)
    axes.set_ylim(bottom=0.0)
