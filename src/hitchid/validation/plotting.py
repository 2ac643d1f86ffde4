"""Plots of validations and comparisons: which arrays are drawn, with which texts."""

from collections.abc import Sequence
from operator import itemgetter

import numpy as np
from matplotlib.axes import Axes

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.plots import (
    ErrorBin,
    draw_band,
    draw_correlation,
    draw_error_bins,
    draw_errors,
    draw_measured,
    draw_predicted,
)
from hitchid.plots.style import canvas
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import (
    FREE_RUN,
    Predictions,
    concatenate_tests,
    concatenated_time,
    label,
    shown_tests,
)

FIT_IN, RESIDUALS_IN = 4.4, 6.4  # heights of new figures, inch; chosen
VARIABLES = {
    "position": "displacement / {unit}",
    "speed": "speed / ({unit}/s)",
    "command": "command / {command}",
}


def plot_fit(
    predictions: Predictions,
    models: Sequence[str],
    axes: Sequence[Axes] | np.ndarray | None,
    *,
    section: str,
    test: str | None,
    unit: str,
) -> np.ndarray:
    """Draw measured and predicted displacement of unseen tests, and errors below; see `Validation.plot`."""
    if not models:
        raise InputError("models: expected at least one, got none")
    for model in models:
        checks.one_of(model, predictions.models, "models")
    if test is not None:
        number = predictions.names.index(checks.one_of(test, predictions.names, "test"))
        predictions = predictions.take([number])
    shown, selection = shown_tests(predictions, models[-1])
    if len(shown.names) == 1:
        (selection,) = shown.names
    with canvas(axes, 2, height_in=FIT_IN, sharex=True, height_ratios=[3, 2]) as drawn:
        displacement_axes, error_axes = drawn
        draw_fit(displacement_axes, error_axes, shown, unit, models)
        if axes is None:
            drawn[0].set_title(f"{section}: {selection}", loc="left")
    return drawn


def draw_fit(
    displacement_axes: Axes,
    error_axes: Axes,
    tests: Predictions,
    unit: str,
    models: Sequence[str],
    *,
    thin: bool = False,
) -> None:
    """Draw measured on top of predicted displacement with the band of the free run, and the errors.

    Several tests follow each other without their first sample, which is the initial value.
    """
    joined = concatenate_tests if len(tests.names) > 1 else itemgetter(0)
    time_s, measured = concatenated_time(tests), joined(tests.actual)
    if tests.band is not None:
        lower, upper = (joined(rows) for rows in tests.band)
        middle = joined(tests.models[FREE_RUN])
        draw_band(displacement_axes, time_s, lower, upper, "90 % band of the free run", thin=thin)
        with np.errstate(invalid="ignore"):
            draw_band(error_axes, time_s, lower - middle, upper - middle, thin=thin)
    for model in models:
        predicted = joined(tests.models[model])
        draw_predicted(displacement_axes, time_s, predicted, model, label(model), thin=thin)
        draw_errors(error_axes, time_s, measured - predicted, model, thin=thin)
    draw_measured(displacement_axes, time_s, measured, thin=thin)
    displacement_axes.set_ylabel(f"displacement / {unit}")
    error_axes.set_ylabel(f"error / {unit}")
    error_axes.set_xlabel("time / s" if len(tests.names) == 1 else "time, test after test / s")


def plot_residuals(
    residuals: ResidualTests | None,
    axes: Sequence[Axes] | np.ndarray | None,
    *,
    title: str,
    unit: str,
    command_unit: str,
) -> np.ndarray:
    """Draw correlations of the errors, and errors over variables; see `Validation.plot_residuals`."""
    with canvas(axes, 5, height_in=RESIDUALS_IN) as drawn:
        if residuals is None:
            for subplot in drawn:
                subplot.text(0.5, 0.5, f"{title}: diverged", ha="center", transform=subplot.transAxes)
        else:
            draw_residual_correlations(drawn[0], drawn[1], residuals)
            draw_residuals_by_variable(drawn[2:], residuals, unit, command_unit)
        if axes is None:
            drawn[0].set_title(title, loc="left")
    return drawn


def draw_residual_correlations(
    autocorrelation_axes: Axes, cross_correlation_axes: Axes, residuals: ResidualTests
) -> None:
    """Draw autocorrelation of the errors and their correlation with the command, with 99 % bounds."""
    bounds = np.array(residuals.autocorrelation_bounds)
    lags_s = residuals.step_s * np.arange(1, bounds.size + 1)
    draw_correlation(autocorrelation_axes, lags_s, residuals.autocorrelation, bounds)
    autocorrelation_axes.set_ylabel("autocorrelation\nof errors")
    autocorrelation_axes.set_xlabel("lag / s")
    lags_s = residuals.step_s * np.array(residuals.cross_lags)
    draw_correlation(
        cross_correlation_axes, lags_s, residuals.cross_correlation, np.array(residuals.cross_bounds)
    )
    cross_correlation_axes.set_ylabel("correlation of errors\nwith command")
    cross_correlation_axes.set_xlabel("lag of the errors behind the command / s")


def draw_residuals_by_variable(
    axes: Sequence[Axes] | np.ndarray, residuals: ResidualTests, unit: str, command_unit: str
) -> None:
    """Draw mean and spread of the errors over displacement, speed and command, one axes each."""
    for subplot, (name, text) in zip(axes, VARIABLES.items(), strict=True):
        bins = [
            ErrorBin(row.lower, row.upper, row.mean, float(np.sqrt(max(row.rmse**2 - row.mean**2, 0.0))))
            for row in residuals.by_quantity[name].bins
        ]
        draw_error_bins(subplot, bins, text.format(unit=unit, command=command_unit))
    axes[1].set_ylabel(f"error, mean ± std / {unit}")
