"""Correlations of errors, and errors by the value of a quantity."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from hitchid.plots.style import COLOURS, FAINT, INK

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
