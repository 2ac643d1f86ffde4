"""Figures of errors: outputs, tests, horizons, distributions, coverage of the bands, tests of residuals."""

from collections.abc import Mapping, Sequence

import numpy as np
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
from hitchid.report.document import Picture
from hitchid.validation import BandFigures, Horizons, Predictions
from hitchid.validation.plotting import (
    VARIABLES,
    draw_fit,
    draw_residual_correlations,
    draw_residuals_by_variable,
)
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import concatenate_tests, label

FIGURE_SAMPLES, QUANTILES = 2000, 201  # samples, as in the paper; points of a cumulative curve


@styled
def predicted_errors(
    name: str, subsets: Mapping[str, Predictions], unit: str, caption: str, alt: str
) -> Picture:
    """Return the benchmark's error and its prediction one step ahead, 2000 samples (paper, Fig. 7 and 8)."""
    several = len(subsets) > 1
    data = {}
    figure = Figure(figsize=(COLUMN_IN, 0.3 + 1.6 * len(subsets)))
    axes = np.atleast_1d(figure.subplots(len(subsets), 1, sharex=True))
    for axis, (subset, tests) in zip(axes, subsets.items(), strict=True):
        measured, benchmark, one_step = (
            concatenate_tests(rows)[:FIGURE_SAMPLES]
            for rows in (tests.actual, tests.models["benchmark"], tests.models["one_step"])
        )
        actual, predicted = measured - benchmark, one_step - benchmark
        data |= {f"{subset}_actual_{unit}": actual, f"{subset}_predicted_{unit}": predicted}
        sample = np.arange(measured.size)
        axis.plot(*decimate(sample, actual), color=INK, label="actual")
        axis.plot(
            *decimate(sample, predicted),
            color=SUBSET_COLOURS.get(subset, COLOURS["one_step"]),
            label=f"predicted one step ahead{f', {subset}' if several else ''}",
        )
        axis.set_ylabel(f"error, {subset} / {unit}" if several else f"error / {unit}")
    legend_above(figure, *axes, columns=1 if several else 2)
    axes[-1].set_xlabel("sample, test after test")
    return Picture(name, figure, caption, alt, data=data)


@styled
def error_distribution(
    name: str, rows: Mapping[str, np.ndarray], unit: str, caption: str, alt: str
) -> Picture:
    """Return histogram with fitted normal, and cumulative distribution of |error| (paper, Fig. 9 and 10)."""
    figure = Figure(figsize=(COLUMN_IN, 3.9))
    histogram_axis, distribution_axis = figure.subplots(2, 1)
    finite_errors = [errors for errors in rows.values() if _has_finite_mean_square(errors)]
    half_width = (
        max((float(np.quantile(np.abs(errors), 0.995)) for errors in finite_errors), default=0.0) or 1.0
    )
    for row, errors in rows.items():
        colour = SUBSET_COLOURS.get(row) or COLOURS.get(row, INK)
        if not _has_finite_mean_square(errors):
            histogram_axis.plot([], [], color=colour, linewidth=0.9, label=f"{label(row)}: diverged")
            continue
        mean, spread = float(errors.mean()), float(errors.std())
        inside = errors[np.abs(errors) <= half_width]
        bins = np.linspace(-half_width, half_width, 61)
        # Of all errors, also those beyond the axis: the area is the share of samples that is shown.
        weights = np.full(inside.size, 1.0 / (errors.size * (bins[1] - bins[0])))
        histogram_axis.hist(inside, bins=bins.tolist(), weights=weights, color=colour, alpha=0.2)
        if spread > 0:
            grid = np.linspace(-half_width, half_width, 200)
            density = np.exp(-0.5 * ((grid - mean) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
            histogram_axis.plot(grid, density, color=colour, linewidth=0.9, label=label(row))
        else:
            histogram_axis.plot([mean], [0], "o", color=colour, markersize=3, label=label(row), clip_on=False)
        share = np.linspace(0, 1, QUANTILES)
        distribution_axis.plot(
            np.quantile(np.abs(errors), share),
            100 * share,
            color=colour,
            dashes=DASHES.get(row, (None, None)),
        )
    histogram_axis.set_xlim(-half_width, half_width)
    histogram_axis.set_xlabel(f"error / {unit}")
    histogram_axis.set_ylabel(f"density / (1/{unit})")
    distribution_axis.set_xlim(0, half_width)
    distribution_axis.set_ylim(0, 100)
    distribution_axis.set_xlabel(f"absolute error / {unit}")
    distribution_axis.set_ylabel("share of samples below / %")
    legend_above(figure, histogram_axis)
    data = {f"{row}_error_{unit}": errors for row, errors in rows.items()}
    return Picture(name, figure, caption, alt, data=data)


@styled
def outputs(
    name: str,
    tests: Predictions,
    unit: str,
    models: Sequence[str],
    caption: str,
    alt: str,
    *,
    recorded: Sequence[str] = (),
) -> Picture:
    """Return measured and predicted displacement, and the errors, tests concatenated (paper, Fig. 11, 12).

    The tests share one axis, so they are few. `recorded` are the predictions in its data; those that are
    drawn if there are none.
    """
    figure = Figure(figsize=(COLUMN_IN, 4.2))
    displacement_axes, error_axes = figure.subplots(2, 1, sharex=True)
    draw_fit(displacement_axes, error_axes, tests, unit, models, thin=True)
    legend_above(figure, displacement_axes)
    figure.align_ylabels()
    data: dict[str, Sequence | np.ndarray] = {
        "test": [test for test, time_s in zip(tests.names, tests.time_s, strict=True) for _ in time_s],
        "time_s": np.concatenate(tests.time_s),
        f"measured_{unit}": np.concatenate(tests.actual),
        **{f"{model}_{unit}": np.concatenate(tests.models[model]) for model in recorded or models},
    }
    if tests.band is not None:
        lower, upper = map(np.concatenate, tests.band)
        data |= {f"free_run_band_lower_{unit}": lower, f"free_run_band_upper_{unit}": upper}
    return Picture(name, figure, caption, alt, data=data)


@styled
def errors_by_test(
    name: str, tests: Predictions, unit: str, models: Sequence[str], caption: str, alt: str
) -> Picture:
    """Return the RMSE of every test in free run, one row of points per model, from the bottom up."""
    figure = Figure(figsize=(COLUMN_IN, 0.7 + 0.32 * len(models)))
    axis = figure.subplots()
    rmse = {model: tests.rmse(model) for model in models}
    for row_index, model in enumerate(models):
        errors = np.where(np.isfinite(rmse[model]), rmse[model], np.nan)
        axis.plot(
            errors,
            np.full(errors.size, row_index),
            MARKERS.get(model, "o"),
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
    data = {"test": tests.names, **{f"{model}_rmse_{unit}": errors for model, errors in rmse.items()}}
    return Picture(name, figure, caption, alt, data=data)


@styled
def horizons(name: str, errors: Horizons, step_s: float, unit: str, caption: str, alt: str) -> Picture:
    """Return the error over the prediction horizon."""
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
    data = {
        "horizon_samples": errors.steps,
        "horizon_s": ahead_s,
        **{f"{model}_rmse_{unit}": values for model, values in errors.rmse.items()},
    }
    return Picture(name, figure, caption, alt, data=data)


@styled
def residual_correlations(name: str, residuals: ResidualTests) -> Picture:
    """Return autocorrelation of the errors and their cross-correlation with the command, with 99 % bounds."""
    figure = Figure(figsize=(COLUMN_IN, 3.4))
    autocorrelation_axes, cross_correlation_axes = figure.subplots(2, 1)
    draw_residual_correlations(autocorrelation_axes, cross_correlation_axes, residuals)
    legend_above(figure, autocorrelation_axes)
    figure.align_ylabels()
    return Picture(
        name,
        figure,
        "Free run: autocorrelation of the errors and correlation with the command. Values outside "
        "the bounds are errors that a better model could explain.",
        "Autocorrelation of the errors and their correlation with the command, with 99 % bounds.",
        data={
            "lag_s": residuals.step_s * np.arange(1, len(residuals.autocorrelation) + 1),
            "autocorrelation": residuals.autocorrelation,
            "autocorrelation_bound": residuals.autocorrelation_bounds,
            "command_lag_s": residuals.step_s * np.array(residuals.cross_lags),
            "command_correlation": residuals.cross_correlation,
            "command_correlation_bound": residuals.cross_bounds,
        },
    )


@styled
def residuals_by_variable(name: str, residuals: ResidualTests, unit: str, command_unit: str) -> Picture:
    """Return mean and spread of the errors over displacement, speed and command."""
    figure = Figure(figsize=(COLUMN_IN, 4.4))
    axes = figure.subplots(len(VARIABLES), 1, sharey=True)
    draw_residuals_by_variable(axes, residuals, unit, command_unit)
    units = {"position": unit, "speed": f"{unit}/s", "command": command_unit}
    data = {}
    for quantity, group in residuals.by_quantity.items():
        data |= {
            f"{quantity}_lower_{units[quantity]}": [interval.lower for interval in group.bins],
            f"{quantity}_upper_{units[quantity]}": [interval.upper for interval in group.bins],
            f"{quantity}_mean_error_{unit}": [interval.mean for interval in group.bins],
            f"{quantity}_rmse_{unit}": [interval.rmse for interval in group.bins],
        }
    return Picture(
        name,
        figure,
        "Free run: mean error (bar) and its spread (line) by displacement, speed and command beyond "
        "the dead zone. A bar away from zero is a systematic error.",
        f"Mean and spread of the errors in {unit} by displacement, speed and command.",
        data=data,
    )


@styled
def coverage(name: str, bands: BandFigures, step_s: float) -> Picture:
    """Return the share of unseen samples inside the bands, over the prediction horizon."""
    figure = Figure(figsize=(COLUMN_IN, 2.2))
    axis = figure.subplots()
    data: dict[str, Sequence | np.ndarray] = {}
    free = 100 * bands.covered
    least = free
    if bands.horizons is not None:
        covered = 100 * np.array(bands.horizons.covered)
        ahead_s = step_s * np.array(bands.horizons.steps)
        axis.plot(ahead_s, covered, "o-", color=COLOURS["one_step"], label="ahead", clip_on=False)
        least = min(free, covered.min())
        data = {"horizon_s": ahead_s, "horizon_covered_share": bands.horizons.covered}
    axis.axhline(free, color=COLOURS["free_run"], linestyle="--", label="free run")
    axis.axhline(100 * bands.coverage, color=INK, linewidth=0.8, label="nominal")
    logarithmic(axis.xaxis)
    axis.set_ylim(min(70.0, least - 2), 100)
    axis.set_xlabel("prediction horizon / s")
    axis.set_ylabel("unseen samples covered / %")
    legend_above(figure, axis, columns=3)
    return Picture(
        name,
        figure,
        "Share of unseen samples inside the bands, and their nominal coverage.",
        "Coverage of the bands in percent over the horizon.",
        data=data | {"nominal_share": (bands.coverage,), "free_run_covered_share": (bands.covered,)},
    )


def _has_finite_mean_square(errors: np.ndarray) -> bool:
    """Return whether the mean square of errors is finite, that is, the model has not diverged."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.sum(errors**2)))
