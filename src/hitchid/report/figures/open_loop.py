"""Figures of a tuned controller: its open loop with what the tests leave open, and steps on drawn models."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchid.control import OpenLoop, TrialRun
from hitchid.plots.style import COLOURS, FAINT, INK, PAGE_IN, legend_above, styled

HEIGHT_IN = 4.4  # of a figure, inch; chosen
QUANTILES = (0.025, 0.975)  # of the draws: ends of a band of 95 %
COLOUR = {"lifting": COLOURS["one_step"], "lowering": COLOURS["transfer_function"]}
DASH = {"lifting": (None, None), "lowering": (4, 1.5)}


@styled
def bode(loops: Mapping[str, OpenLoop]) -> Figure:
    """Return magnitude and phase of the open loops over frequency, with the band of the draws."""
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    magnitude, phase = figure.subplots(2, 1, sharex=True)
    for direction, loop in loops.items():
        _band(magnitude, direction, loop, 20 * np.log10(np.abs(loop.response)))
        _band(phase, direction, loop, np.rad2deg(_phase(loop)))
    magnitude.axhline(0.0, color=FAINT, linewidth=0.6)
    phase.axhline(-180.0, color=FAINT, linewidth=0.6)
    magnitude.set_ylim(-60.0, 60.0)
    phase.set_ylim(-360.0, 0.0)
    magnitude.set_ylabel("open loop / dB")
    phase.set_ylabel("phase / °")
    phase.set_xlabel("frequency / Hz")
    legend_above(figure, magnitude, phase, columns=2)
    figure.align_ylabels()
    return figure


@styled
def nichols(loops: Mapping[str, OpenLoop], largest_sensitivity: float) -> Figure:
    """Return magnitude over phase of the open loops, each draw, and the limit of the sensitivity."""
    figure = Figure(figsize=(PAGE_IN, HEIGHT_IN))
    axes = figure.subplots()
    for direction, loop in loops.items():
        phase, size = np.rad2deg(_phase(loop)), 20 * np.log10(np.abs(loop.response))
        axes.plot(phase[1:].T, size[1:].T, color=COLOUR[direction], linewidth=0.3, alpha=0.15)
        axes.plot(
            phase[0], size[0], color=COLOUR[direction], dashes=DASH[direction], linewidth=1.2, label=direction
        )
    angle = np.linspace(0, 2 * np.pi, 361)
    circle = -1 + np.exp(1j * angle) / largest_sensitivity
    curve = np.rad2deg(np.angle(circle)) % 360 - 360
    axes.plot(
        curve, 20 * np.log10(np.abs(circle)), color=INK, linewidth=0.9, label=f"Ms {largest_sensitivity:g}"
    )
    axes.plot(-180, 0, "+", color=INK)
    axes.set_xlim(-300, -60)
    axes.set_ylim(-30, 30)
    axes.set_xlabel("phase / °")
    axes.set_ylabel("open loop / dB")
    legend_above(figure, axes, columns=3)
    return figure


@styled
def sensitivity(loops: Mapping[str, OpenLoop], largest: float) -> Figure:
    """Return the magnitude of the sensitivity over frequency, with the band of the draws and its limit."""
    figure = Figure(figsize=(PAGE_IN, 0.7 * HEIGHT_IN))
    axes = figure.subplots()
    for direction, loop in loops.items():
        _band(axes, direction, loop, np.abs(1 / (1 + loop.response)))
    axes.axhline(largest, color=INK, linewidth=0.9, label=f"Ms {largest:g}")
    axes.set_ylabel("sensitivity")
    axes.set_xlabel("frequency / Hz")
    legend_above(figure, axes, columns=3)
    return figure


@styled
def step_fan(steps: Sequence[TrialRun], unit: str) -> Figure:
    """Return steps of the controller on models with drawn parameters, loads and noise."""
    figure = Figure(figsize=(PAGE_IN, 0.8 * HEIGHT_IN))
    for axes, step in zip(figure.subplots(1, len(steps), squeeze=False)[0], steps, strict=True):
        axes.plot(step.time_s, step.measured.T, color=COLOURS["greybox"], linewidth=0.5)
        axes.plot(step.time_s, step.target, color=INK, linewidth=0.9, label="target")
        axes.set_xlabel("time / s")
        axes.set_ylabel(f"measured displacement / {unit}")
    return figure


def _phase(loop: OpenLoop) -> Float[np.ndarray, "s f"]:
    """Return the continuous phase, which begins between −360° and 0."""
    phase = np.unwrap(np.angle(loop.response), axis=-1)
    return phase - 2 * np.pi * np.ceil(phase[:, :1] / (2 * np.pi))


def _band(axes: Axes, direction: str, loop: OpenLoop, rows: Float[np.ndarray, "s f"]) -> None:
    frequency_hz = loop.omega / (2 * np.pi)
    lower, upper = np.quantile(rows[1:], QUANTILES, axis=0)
    axes.fill_between(frequency_hz, lower, upper, color=COLOUR[direction], alpha=0.2, linewidth=0)
    axes.semilogx(
        frequency_hz,
        rows[0],
        color=COLOUR[direction],
        dashes=DASH[direction],
        linewidth=1.2,
        label=direction,
    )
