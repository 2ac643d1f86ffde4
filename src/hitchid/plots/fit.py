"""Measured and predicted displacement, their band, and the errors."""

import numpy as np
from matplotlib.axes import Axes

from hitchid.plots.style import COLOURS, DASHES, INK, curve

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
