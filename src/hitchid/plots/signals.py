"""Signals over time: displacement, segments and commands of a test, predictions with their band, errors."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from hitchid.plots.style import COLOURS, DASHES, FAINT, INK, curve

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
    """Draw displacement over time.

    Args:
        axes: to draw into.
        time_s, displacement: the samples, shape [N].
        unit: of the displacement.
        thin: whether the curve is decimated.
    """
    axes.plot(*curve(time_s, displacement, thin=thin), color=INK)
    axes.set_ylabel(f"displacement / {unit}")


def draw_segments(axes: Axes, segments: Sequence[tuple[str, float, float]]) -> None:
    """Colour the background by what the hitch does.

    Args:
        axes: to draw into.
        segments: label, a key of `SEGMENT_COLOURS`, with start and end, s.
    """
    for label, start_s, stop_s in segments:
        alpha = 1.0 if label == "hold" else ALPHA
        axes.axvspan(start_s, stop_s, color=SEGMENT_COLOURS[label], alpha=alpha, linewidth=0, label=label)


def draw_commands(
    axes: Axes, time_s: np.ndarray, commands: Mapping[str, np.ndarray], unit: str, *, thin: bool = False
) -> None:
    """Draw the command of each direction over time.

    Args:
        axes: to draw into.
        time_s: time of the samples, shape [N].
        commands: direction to command, shape [N].
        unit: of the commands.
        thin: whether curves are decimated.
    """
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
    """Draw mean (bar) and standard deviation (line) of the errors over a quantity.

    Args:
        axes: to draw into.
        bins: by rising value of the quantity.
        label: of the quantity's axis, with its unit.
    """
    least = MIN_BAR_SHARE * (max(each.upper for each in bins) - min(each.lower for each in bins))
    for each in bins:
        middle, half = 0.5 * (each.lower + each.upper), 0.5 * max(each.upper - each.lower, least)
        axes.plot([middle] * 2, [each.mean - each.deviation, each.mean + each.deviation], color=FAINT)
        axes.plot([middle - half, middle + half], [each.mean] * 2, color=COLOURS["free_run"], linewidth=2)
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
    """Draw displacement that a model predicts.

    Args:
        axes: to draw into.
        time_s, predicted: the samples, shape [N]; NaN is a gap.
        model: key of the model, for colour and dashes.
        label: for the legend.
        thin: whether the curve is decimated.
    """
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
    """Fill the band around a free run.

    Args:
        axes: to draw into.
        time_s, lower, upper: ends of the band, shape [N]; NaN is a gap.
        label: for the legend; None for none.
        thin: whether the band is decimated.
    """
    shown = _coarse_indices(lower) if thin else slice(None)
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


def _coarse_indices(smooth: np.ndarray) -> np.ndarray:
    """Return the indices of about 300 samples of a smooth curve, with its gaps and their neighbours."""
    gaps = np.flatnonzero(np.isnan(smooth))
    indices = np.concatenate(
        [np.arange(0, smooth.size, max(1, smooth.size // BAND_POINTS)), gaps, gaps - 1, gaps + 1]
    )
    return np.unique(indices[(indices >= 0) & (indices < smooth.size)])
