"""What is drawn into axes: signals over time, errors, and what a model says over command and frequency."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from hitchid.plots.style import COLOURS, DASHES, FAINT, INK, curve, logarithmic

# Displacement, its segments, and commands.

SEGMENT_COLOURS = {
    "lifting": COLOURS["one_step"],
    "lowering": COLOURS["narx"],
    "hold": COLOURS["hold"],
    "saturated": COLOURS["transfer_function"],
    "end stop": COLOURS["faint"],
    "both valves on": COLOURS["benchmark"],
}
"""Label of a segment, as `data.segmentation` has it, to its colour."""
DIRECTION_COLOURS = {direction: SEGMENT_COLOURS[direction] for direction in ("lifting", "lowering")}
ALPHA = 0.35  # opacity of a segment; chosen


def draw_displacement(
    axes: Axes, time_s: np.ndarray, displacement: np.ndarray, unit: str, *, thin: bool = False
) -> None:
    """Draw displacement over time, shape [N]; decimated where `thin`."""
    axes.plot(*curve(time_s, displacement, thin=thin), color=INK)
    axes.set_ylabel(f"displacement / {unit}")


def draw_segments(axes: Axes, segments: Sequence[tuple[str, float, float]]) -> None:
    """Colour the background by what the hitch does: label, a key of `SEGMENT_COLOURS`, start and end, s."""
    for label, start_s, stop_s in segments:
        alpha = 1.0 if label == "hold" else ALPHA
        axes.axvspan(start_s, stop_s, color=SEGMENT_COLOURS[label], alpha=alpha, linewidth=0, label=label)


def draw_commands(
    axes: Axes, time_s: np.ndarray, commands: Mapping[str, np.ndarray], unit: str, *, thin: bool = False
) -> None:
    """Draw the command of each direction over time, shape [N]; decimated where `thin`."""
    for direction, command in commands.items():
        axes.plot(
            *curve(time_s, command, thin=thin),
            color=DIRECTION_COLOURS[direction],
            label=f"{direction} command",
        )
    axes.set_ylabel(f"command /\n{unit}")
    axes.set_xlabel("time / s")


# Correlations of errors, and errors by the value of a quantity.

HEADROOM = 1.15  # end of a correlation's axis over the largest value or bound; chosen
MIN_BAR_SHARE = 0.02  # smallest width of a bar, share of the axis; chosen


class ErrorBin(NamedTuple):
    """Mean and standard deviation of the errors where a quantity lies from `lower` to `upper`."""

    lower: float
    upper: float
    mean: float
    deviation: float


def draw_correlation(axes: Axes, lags_s: np.ndarray, values: Sequence[float], bounds: np.ndarray) -> None:
    """Draw a correlation over the lag, with its 99 % bounds, each of shape [K]; lags in s."""
    axes.fill_between(lags_s, -bounds, bounds, color=FAINT, alpha=0.3, linewidth=0, label="99 % bounds")
    axes.vlines(lags_s, 0, values, color=COLOURS["free_run"], linewidth=1.4)
    axes.axhline(0, color=INK, linewidth=0.6)
    largest = max(float(np.max(np.abs(values))), float(bounds.max()))
    axes.set_ylim(-HEADROOM * largest, HEADROOM * largest)


def draw_error_bins(axes: Axes, bins: Sequence[ErrorBin], label: str) -> None:
    """Draw mean (bar) and standard deviation (line) of the errors over a quantity, by its rising value."""
    least = MIN_BAR_SHARE * (max(errors.upper for errors in bins) - min(errors.lower for errors in bins))
    for lower, upper, mean, deviation in bins:
        middle, half = 0.5 * (lower + upper), 0.5 * max(upper - lower, least)
        axes.plot([middle] * 2, [mean - deviation, mean + deviation], color=FAINT)
        axes.plot([middle - half, middle + half], [mean] * 2, color=COLOURS["free_run"], linewidth=2)
    axes.axhline(0, color=INK, linewidth=0.6)
    axes.set_xlabel(label)


BAND_POINTS = 300  # of a thinned band; chosen: a band is smooth
# The measured curve is thin and dark, above the wide and lighter predicted ones, so that both are seen where
# they agree; widths in points, all chosen.
MEASURED = {"color": INK, "linewidth": 0.7, "zorder": 3.0}
PREDICTED_WIDTH, PREDICTED_ALPHA, ERROR_WIDTH, BAND_ALPHA = 2.2, 0.65, 0.8, 0.25


def draw_measured(axes: Axes, time_s: np.ndarray, measured: np.ndarray, *, thin: bool = False) -> None:
    """Draw measured displacement above everything else, shape [N]; decimated where `thin`."""
    axes.plot(*curve(time_s, measured, thin=thin), label="measured", **MEASURED)


def draw_predicted(
    axes: Axes, time_s: np.ndarray, predicted: np.ndarray, model: str, label: str, *, thin: bool = False
) -> None:
    """Draw displacement that a model predicts, in its colour and dashes, shape [N]; NaN is a gap."""
    axes.plot(
        *curve(time_s, predicted, thin=thin),
        label=label,
        linewidth=PREDICTED_WIDTH,
        alpha=PREDICTED_ALPHA,
        **_line_style(model),
    )


def draw_errors(
    axes: Axes, time_s: np.ndarray, errors: np.ndarray, model: str, *, thin: bool = False
) -> None:
    """Draw measured minus predicted displacement of a model; see `draw_predicted`."""
    axes.plot(*curve(time_s, errors, thin=thin), linewidth=ERROR_WIDTH, **_line_style(model))


def draw_band(
    axes: Axes,
    time_s: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    label: str | None = None,
    *,
    thin: bool = False,
) -> None:
    """Fill the band around a free run, shape [N]; NaN is a gap."""
    shown: slice | np.ndarray = slice(None)
    if thin:
        # About 300 samples of the smooth curve, with its gaps and their neighbours.
        gaps = np.flatnonzero(np.isnan(lower))
        coarse = np.arange(0, lower.size, max(1, lower.size // BAND_POINTS))
        indices = np.concatenate([coarse, gaps, gaps - 1, gaps + 1])
        shown = np.unique(indices[(indices >= 0) & (indices < lower.size)])
    axes.fill_between(
        time_s[shown],
        lower[shown],
        upper[shown],
        label=label,
        color=COLOURS["free_run"],
        alpha=BAND_ALPHA,
        linewidth=0,
    )


def _line_style(model: str) -> dict:
    return {"color": COLOURS.get(model, INK), "dashes": DASHES.get(model, (None, None))}


# Responses of a model with bands: to command steps over time, and over frequency.

MAP_ALPHA = 0.22  # opacity of a band; chosen
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
            axes.fill_between(x, lower, upper, color=colour, alpha=MAP_ALPHA, linewidth=0)
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
    """Draw a Bode diagram over Hz: magnitudes in dB, of which 0 is one `unit`, and phases in degrees."""
    draw_curves(magnitude_axes, magnitudes, "", f"magnitude (re 1 {unit}) / dB")
    draw_curves(phase_axes, [phase._replace(label=None) for phase in phases], "frequency / Hz", "phase / °")
    for axes, spacing in ((magnitude_axes, DECIBELS_PER_TICK), (phase_axes, DEGREES_PER_TICK)):
        logarithmic(axes.xaxis)
        low, high = axes.get_ylim()
        if high - low >= spacing:
            axes.yaxis.set_major_locator(MultipleLocator(spacing * -(-(high - low) // (MAX_TICKS * spacing))))


LINE_STYLES = (("one_step", "v", "--"), ("benchmark", "s", "-"), ("greybox", "^", "-."))
MAP_HEADROOM = 1.5  # top of the axis over the fastest speed; chosen


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

    Points of curves with a band are operating points, whose open upper end extends to the edge; a curve
    without one is drawn without points.
    """
    measured_speeds = [speed for _, speed in measured]
    fastest = max([float(by_load.speeds.max()) for by_load in curves] + measured_speeds)
    highest = MAP_HEADROOM * fastest or 1.0
    styles = LINE_STYLES if len(curves) > 1 else LINE_STYLES[1:2]
    for by_load, (colour, marker, dashes) in zip(curves, styles, strict=False):
        shade = COLOURS[colour]
        if by_load.lower is None or by_load.upper is None:
            axes.plot(by_load.commands, by_load.speeds, label=by_load.label, color=shade)
            continue
        upper = np.where(np.isfinite(by_load.upper), by_load.upper, highest)
        if by_load.commands.size == 1:
            axes.vlines(by_load.commands, by_load.lower, upper, alpha=MAP_ALPHA, linewidth=4, color=shade)
        axes.fill_between(by_load.commands, by_load.lower, upper, alpha=MAP_ALPHA, linewidth=0, color=shade)
        axes.plot(
            by_load.commands,
            by_load.speeds,
            dashes,
            marker=marker,
            markersize=3,
            label=by_load.label,
            color=shade,
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
        axes.axvspan(lower, upper, color=FAINT, alpha=MAP_ALPHA, linewidth=0)
