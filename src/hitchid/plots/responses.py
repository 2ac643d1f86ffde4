"""Responses of a model with bands: to command steps over time, and over frequency."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from hitchid.plots.style import COLOURS, logarithmic

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
