"""Figures of uncertainty: parameter intervals, band coverage, tests of residuals."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import (
    FixedLocator,
    Locator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    StrMethodFormatter,
)

from hitchid._support.inert import printable
from hitchid.model import Estimate, LoadScatter
from hitchid.plots.style import COLOURS, COLUMN_IN, FAINT, INK, legend_above, logarithmic, styled
from hitchid.validation import BandFigures
from hitchid.validation.plotting import VARIABLES, draw_residual_correlations, draw_residuals_by_variable
from hitchid.validation.residuals import ResidualTests

MARGIN = 0.6  # margin of an interval, share of its width; all values chosen
ROW_IN, NAMED_ROWS = 0.16, 48  # height of a test, in; tests whose names fit on a page; chosen
WIDE_RATIO = 5  # ratio of the ends of a logarithmic axis above which its ticks are logarithmic


@styled
def intervals(estimates: Sequence[Estimate]) -> Figure:
    """Return each parameter with its 95 % interval, one row with its own scale per parameter.

    Open ends are arrows to the edge; the thin line is the bootstrap interval.

    Args:
        estimates: of the parameters of one direction.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.25 + 0.62 * len(estimates)))
    for axis, estimate in zip(np.atleast_1d(figure.subplots(len(estimates), 1)), estimates, strict=True):
        _interval(axis, estimate)
    return figure


def _ticks(edge: np.ndarray) -> Locator:
    """Return ticks that do not overlap on a logarithmic axis; linear ticks on a short one."""
    if edge[1] < WIDE_RATIO * edge[0]:
        return MaxNLocator(4)
    return FixedLocator(sorted({float(f"{x:.1g}") for x in np.geomspace(edge[0], edge[1], 5)[1:-1]}))


def _interval(axis: Axes, estimate: Estimate) -> None:
    interval, value = estimate.interval, estimate.value
    positive = estimate.lower > 0 and min([value, *(end for end in interval if end is not None)]) > 0
    finite_values = [np.log(x) if positive else x for x in (value, *interval) if x is not None]
    spread = (max(finite_values) - min(finite_values)) or (1.0 if positive else abs(value) or 1.0)
    low, high = min(finite_values) - MARGIN * spread, max(finite_values) + MARGIN * spread
    edge = np.exp([low, high]) if positive else np.array([low, high])
    axis.set_xscale("log" if positive else "linear")
    axis.set_xlim(*edge)
    line_ends = [edge[side] if end is None else end for side, end in enumerate(interval)]
    colour = COLOURS["benchmark"] if estimate.determined else FAINT
    axis.plot(line_ends, [0, 0], color=colour, linewidth=4, solid_capstyle="butt")
    for side, marker in enumerate("<>"):
        if interval[side] is None:
            axis.plot([edge[side]], [0], marker, color=colour, markersize=6, clip_on=False)
    if estimate.bootstrap and estimate.determined:
        axis.plot(np.array(estimate.bootstrap, dtype=float), [-0.45, -0.45], color=FAINT, linewidth=1.2)
    axis.plot([value], [0], "|", color=INK, markersize=11, markeredgewidth=1.4)
    axis.set_ylim(-1, 1)
    axis.set_yticks([])
    axis.spines["left"].set_visible(False)
    axis.xaxis.set_major_locator(_ticks(edge) if positive else MaxNLocator(4))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:.4g}"))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_minor_formatter(NullFormatter())
    unit = "" if estimate.unit == "1" else f" / {estimate.unit}"
    axis.set_ylabel(f"{estimate.symbol}{unit}", rotation=0, ha="right", va="center")


@styled
def loads(load_scatter: LoadScatter) -> Figure:
    """Return each test's speed above the model's with its 95 % interval, slowest below, in percent.

    The band is ± the scatter between tests. Of very many tests the names are left out.

    Args:
        load_scatter: of one direction.
    """
    tests = sorted(load_scatter.tests, key=lambda test: test.speed)
    figure = Figure(figsize=(COLUMN_IN, 0.6 + ROW_IN * min(len(tests), NAMED_ROWS)))
    axes = figure.subplots()
    speed, lower, upper = 100 * np.array([(test.speed, *test.interval) for test in tests]).T
    rows = np.arange(len(tests))
    axes.axvspan(-100 * load_scatter.scatter, 100 * load_scatter.scatter, color=FAINT, alpha=0.3, linewidth=0)
    axes.axvline(0, color=FAINT, linewidth=0.8)
    colours = [COLOURS["benchmark"] if test.determined else FAINT for test in tests]
    axes.hlines(rows, lower, upper, color=colours, linewidth=1.2)
    axes.plot(speed, rows, "o", color=INK, markersize=3)
    named = len(tests) <= NAMED_ROWS
    axes.set_yticks(rows if named else [], [printable(test.test) for test in tests] if named else [])
    axes.set_ylim(-0.7, len(tests) - 0.3)
    axes.set_xlabel("speed above the model's / %")
    return figure


@styled
def residual_correlations(residuals: ResidualTests) -> Figure:
    """Return autocorrelation of the errors and their cross-correlation with the command, with 99 % bounds.

    Args:
        residuals: of one direction and run.
    """
    figure = Figure(figsize=(COLUMN_IN, 3.4))
    autocorrelation_axes, cross_correlation_axes = figure.subplots(2, 1)
    draw_residual_correlations(autocorrelation_axes, cross_correlation_axes, residuals)
    legend_above(figure, autocorrelation_axes)
    figure.align_ylabels()
    return figure


@styled
def residuals_by_variable(residuals: ResidualTests, unit: str, command_unit: str) -> Figure:
    """Return mean and spread of the errors over displacement, speed and command.

    Args:
        residuals: of one direction and run.
        unit, command_unit: of displacement and command.
    """
    figure = Figure(figsize=(COLUMN_IN, 4.4))
    axes = figure.subplots(len(VARIABLES), 1, sharey=True)
    draw_residuals_by_variable(axes, residuals, unit, command_unit)
    return figure


@styled
def coverage(bands: BandFigures, step_s: float) -> Figure:
    """Return the share of unseen samples inside the bands, over the prediction horizon.

    Args:
        bands: of one direction.
        step_s: sampling time, s.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.2))
    axis = figure.subplots()
    free = 100 * bands.covered
    least = free
    if bands.horizons is not None:
        covered = 100 * np.array(bands.horizons.covered)
        ahead_s = step_s * np.array(bands.horizons.steps)
        axis.plot(ahead_s, covered, "o-", color=COLOURS["one_step"], label="ahead", clip_on=False)
        least = min(free, covered.min())
    axis.axhline(free, color=COLOURS["free_run"], linestyle="--", label="free run")
    axis.axhline(100 * bands.coverage, color=INK, linewidth=0.8, label="nominal")
    logarithmic(axis.xaxis)
    axis.set_ylim(min(70.0, least - 2), 100)
    axis.set_xlabel("prediction horizon / s")
    axis.set_ylabel("unseen samples covered / %")
    legend_above(figure, axis, columns=3)
    return figure
