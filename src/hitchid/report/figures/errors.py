"""Figures of model errors: predicted and actual error, distributions, outputs, tests, horizons."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchid.plots.style import (
    COLOURS,
    COLUMN_IN,
    DASHES,
    INK,
    MARKERS,
    SUBSET_COLOURS,
    decimate,
    finite_or_nan,
    legend_above,
    logarithmic,
    styled,
)
from hitchid.validation import Horizons, Predictions
from hitchid.validation.plotting import draw_fit
from hitchid.validation.results import concatenate_tests, label

MAX_SAMPLES, QUANTILES = 2000, 201  # samples, as in the paper; points of a cumulative curve
PAPER_MODELS = ("one_step", "free_run", "benchmark")


@styled
def predicted_errors(subsets: Mapping[str, Predictions], unit: str) -> Figure:
    """Return the benchmark's error and its prediction one step ahead, 2000 samples (paper, Fig. 7 and 8).

    Args:
        subsets: `training` and `validation`, or another subset of the data, to its tests.
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.3 + 1.6 * len(subsets)))
    axes = np.atleast_1d(figure.subplots(len(subsets), 1, sharex=True))
    for axis, (subset, tests) in zip(axes, subsets.items(), strict=True):
        measured = concatenate_tests(tests.actual)[:MAX_SAMPLES]
        benchmark = concatenate_tests(tests.models["benchmark"])[:MAX_SAMPLES]
        predicted = concatenate_tests(tests.models["one_step"])[:MAX_SAMPLES]
        sample = np.arange(measured.size)
        axis.plot(*decimate(sample, measured - benchmark), color=INK, label="actual")
        colour = SUBSET_COLOURS.get(subset, COLOURS["one_step"])
        axis.plot(
            *decimate(sample, predicted - benchmark),
            color=colour,
            label=_prediction_label(subset, len(subsets)),
        )
        axis.set_ylabel(f"error, {subset} / {unit}" if len(subsets) > 1 else f"error / {unit}")
    legend_above(figure, *axes, columns=1 if len(subsets) > 1 else 2)
    axes[-1].set_xlabel("sample, test after test")
    return figure


@styled
def error_distribution(rows: Mapping[str, np.ndarray], unit: str) -> Figure:
    """Return histogram with fitted normal, and cumulative distribution of |error| (paper, Fig. 9 and 10).

    Args:
        rows: subset of the data, or model, to its errors, shape [M].
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 3.9))
    histogram_axis, distribution_axis = figure.subplots(2, 1)
    finite_errors = [errors for errors in rows.values() if _has_finite_mean_square(errors)]
    half_width = (
        max((float(np.quantile(np.abs(errors), 0.995)) for errors in finite_errors), default=0.0) or 1.0
    )
    for name, errors in rows.items():
        colour = SUBSET_COLOURS.get(name) or COLOURS.get(name, INK)
        if not _has_finite_mean_square(errors):
            histogram_axis.plot([], [], color=colour, linewidth=0.9, label=f"{label(name)}: diverged")
            continue
        _histogram(histogram_axis, errors, half_width, colour, label(name))
        share = np.linspace(0, 1, QUANTILES)
        distribution_axis.plot(
            np.quantile(np.abs(errors), share),
            100 * share,
            color=colour,
            dashes=DASHES.get(name, (None, None)),
        )
    histogram_axis.set_xlim(-half_width, half_width)
    histogram_axis.set_xlabel(f"error / {unit}")
    histogram_axis.set_ylabel(f"density / (1/{unit})")
    distribution_axis.set_xlim(0, half_width)
    distribution_axis.set_ylim(0, 100)
    distribution_axis.set_xlabel(f"absolute error / {unit}")
    distribution_axis.set_ylabel("share of samples below / %")
    legend_above(figure, histogram_axis)
    return figure


@styled
def outputs(tests: Predictions, unit: str, models: Sequence[str] = PAPER_MODELS) -> Figure:
    """Return measured and predicted displacement, and the errors, tests concatenated (paper, Fig. 11, 12).

    Args:
        tests: few, since they share one axis.
        unit: of the displacement.
        models: keys of the predictions to draw.
    """
    figure = Figure(figsize=(COLUMN_IN, 4.2))
    displacement_axes, error_axes = figure.subplots(2, 1, sharex=True)
    draw_fit(displacement_axes, error_axes, tests, unit, models, thin=True)
    legend_above(figure, displacement_axes)
    figure.align_ylabels()
    return figure


@styled
def errors_by_test(tests: Predictions, unit: str, models: Sequence[str]) -> Figure:
    """Return the RMSE of every test in free run, one row of points per model.

    Args:
        tests: all unseen tests.
        unit: of the displacement.
        models: keys of the predictions, from the bottom up.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.7 + 0.32 * len(models)))
    axis = figure.subplots()
    for row_index, model in enumerate(models):
        errors = np.where(np.isfinite(tests.rmse(model)), tests.rmse(model), np.nan)
        sign = MARKERS.get(model, "o")
        axis.plot(
            errors,
            np.full(errors.size, row_index),
            sign,
            color=COLOURS.get(model, INK),
            markersize=4,
            alpha=0.6,
        )
        with np.errstate(over="ignore", invalid="ignore"):
            overall = float(np.sqrt(np.average(errors**2, weights=[row.size for row in tests.actual])))
        axis.plot([overall], [row_index], "|", color=INK, markersize=12, markeredgewidth=1.2)
    axis.set_yticks(range(len(models)), [label(model).partition(", free")[0] for model in models])
    axis.set_ylim(-0.6, len(models) - 0.4)
    logarithmic(axis.xaxis)
    axis.set_xlabel(f"RMSE of each test in free run / {unit}")
    return figure


@styled
def horizons(errors: Horizons, step_s: float, unit: str) -> Figure:
    """Return the error over the prediction horizon.

    Args:
        errors: RMSE of each model.
        step_s: sampling time, s.
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 3.0))
    axis = figure.subplots()
    ahead_s = step_s * np.array(errors.steps)
    for model, values in errors.rmse.items():
        main = model in ("greybox", "benchmark", "persistence")
        axis.plot(
            ahead_s,
            finite_or_nan(values),
            marker=MARKERS.get(model, "o"),
            color=COLOURS.get(model, INK),
            dashes=DASHES.get(model, (None, None)),
            markersize=3.5 if main else 2.5,
            linewidth=1.6 if model == "greybox" else 0.9,
            label=label(model).partition(", free")[0],
            zorder=3 if main else 2,
        )
    logarithmic(axis.xaxis)
    logarithmic(axis.yaxis)
    axis.set_xlabel("prediction horizon / s")
    axis.set_ylabel(f"RMSE / {unit}")
    legend_above(figure, axis)
    return figure


def _prediction_label(subset: str, subset_count: int) -> str:
    return f"predicted one step ahead{f', {subset}' if subset_count > 1 else ''}"


def _has_finite_mean_square(errors: np.ndarray) -> bool:
    """Return whether the mean square of errors is finite, that is, the model has not diverged."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.sum(errors**2)))


def _histogram(axis: Axes, errors: np.ndarray, half_width: float, colour: str, label: str) -> None:
    mean, spread = float(errors.mean()), float(errors.std())
    inside = errors[np.abs(errors) <= half_width]
    bins = np.linspace(-half_width, half_width, 61)
    weights = np.full(inside.size, 1.0 / (errors.size * (bins[1] - bins[0])))
    axis.hist(inside, bins=bins.tolist(), weights=weights, color=colour, alpha=0.2)
    if spread > 0:
        grid = np.linspace(-half_width, half_width, 200)
        density = np.exp(-0.5 * ((grid - mean) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        axis.plot(grid, density, color=colour, linewidth=0.9, label=label)
    else:
        axis.plot([mean], [0], "o", color=colour, markersize=3, label=label, clip_on=False)
