"""Responses of a model with bands: to command steps over time, and over frequency."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from hitchid.plots.style import COLOURS

BAND_ALPHA = 0.22  # opacity of a band; chosen
LEVEL_COLOURS = tuple(COLOURS[name] for name in ("one_step", "benchmark", "greybox", "lstm", "narx", "arx"))
"""Colours of the levels of a command, from the first."""
DEGREES_PER_TICK = 90.0  # of the phase; chosen


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
    for axes in (magnitude_axes, phase_axes):
        axes.set_xscale("log")
    low, high = phase_axes.get_ylim()
    if high - low >= DEGREES_PER_TICK:
        phase_axes.yaxis.set_major_locator(MultipleLocator(DEGREES_PER_TICK * _stride(high - low)))


def _stride(span: float) -> int:
    """Return how many quarter turns lie between two ticks, so that there are eight at most."""
    return int(-(-span // (8 * DEGREES_PER_TICK)))
