"""How a model errs: predicted against actual error, distributions, outputs, tests, horizons."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hitchid.report.figures.style import (
    COLOURS,
    COLUMN_IN,
    DASHES,
    INK,
    LABELS,
    MARKERS,
    PARTS,
    legend_above,
    logarithmic,
    styled,
    thinned,
)
from hitchid.validation import Predictions

SHOWN, QUANTILES = 2000, 201
PAPERS = ("one_step", "free_run", "benchmark")


@styled
def predicted_errors(parts: Mapping[str, Predictions], unit: str) -> Figure:
    """Return the benchmark's error and its prediction one step ahead, 2000 samples (paper, Fig. 7 and 8).

    Args:
        parts: `training` and `validation`, or any other part of the data, to its tests.
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.3 + 1.6 * len(parts)))
    axes = np.atleast_1d(figure.subplots(len(parts), 1, sharex=True))
    for axis, (part, tests) in zip(axes, parts.items(), strict=True):
        measured = end_to_end(tests.actual)[:SHOWN]
        benchmark = end_to_end(tests.models["benchmark"])[:SHOWN]
        predicted = end_to_end(tests.models["one_step"])[:SHOWN]
        sample = np.arange(measured.size)
        axis.plot(*thinned(sample, measured - benchmark), color=INK, label="actual")
        colour = PARTS.get(part, COLOURS["one_step"])
        axis.plot(*thinned(sample, predicted - benchmark), color=colour, label=_predicted(part, len(parts)))
        axis.set_ylabel(f"error, {part} / {unit}" if len(parts) > 1 else f"benchmark's error / {unit}")
    legend_above(figure, *axes, columns=1 if len(parts) > 1 else 2)
    axes[-1].set_xlabel("sample, test after test")
    return figure


@styled
def error_distribution(rows: Mapping[str, np.ndarray], unit: str) -> Figure:
    """Return histogram with fitted normal, and cumulative distribution of |error| (paper, Fig. 9 and 10).

    Args:
        rows: part of the data, or model, to its errors, shape [M].
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 3.9))
    above, below = figure.subplots(2, 1)
    told = [errors for errors in rows.values() if _squares(errors)]
    reach = max((float(np.quantile(np.abs(errors), 0.995)) for errors in told), default=0.0) or 1.0
    for name, errors in rows.items():
        colour = PARTS.get(name) or COLOURS.get(name, INK)
        if not _squares(errors):
            above.plot([], [], color=colour, linewidth=0.9, label=f"{LABELS.get(name, name)}: diverged")
            continue
        _histogram(above, errors, reach, colour, LABELS.get(name, name))
        share = np.linspace(0, 1, QUANTILES)
        below.plot(
            np.quantile(np.abs(errors), share),
            100 * share,
            color=colour,
            dashes=DASHES.get(name, (None, None)),
        )
    above.set_xlim(-reach, reach)
    above.set_xlabel(f"error / {unit}")
    above.set_ylabel(f"density / (1/{unit})")
    below.set_xlim(0, reach)
    below.set_ylim(0, 100)
    below.set_xlabel(f"absolute error / {unit}")
    below.set_ylabel("samples below / %")
    legend_above(figure, above)
    return figure


@styled
def outputs(tests: Predictions, unit: str, models: Sequence[str] = PAPERS) -> Figure:
    """Return measured and predicted displacement, and the errors below, test after test (paper, Fig. 11, 12).

    Args:
        tests: few enough to be told apart.
        unit: of the displacement.
        models: whose predictions are drawn.
    """
    figure = Figure(figsize=(COLUMN_IN, 4.2))
    above, below = figure.subplots(2, 1, sharex=True)
    time_s, measured = joined_time(tests), end_to_end(tests.actual)
    if tests.band is not None:
        lower, upper = (end_to_end(rows) for rows in tests.band)
        filled = {"color": COLOURS["free_run"], "alpha": 0.25, "linewidth": 0}
        coarse = _coarse(lower)
        above.fill_between(
            time_s[coarse], lower[coarse], upper[coarse], label="90 % band of the free run", **filled
        )
        middle = end_to_end(tests.models["free_run"])
        below.fill_between(time_s[coarse], (lower - middle)[coarse], (upper - middle)[coarse], **filled)
    above.plot(*thinned(time_s, measured), color=INK, label="measured")
    for model in models:
        predicted = end_to_end(tests.models[model])
        look = {"color": COLOURS[model], "dashes": DASHES.get(model, (None, None))}
        above.plot(*thinned(time_s, predicted), label=LABELS[model], **look)
        below.plot(*thinned(time_s, measured - predicted), linewidth=0.8, **look)
    above.set_ylabel(f"displacement / {unit}")
    below.set_ylabel(f"error / {unit}")
    below.set_xlabel("time, test after test / s")
    legend_above(figure, above)
    figure.align_ylabels()
    return figure


@styled
def errors_by_test(tests: Predictions, unit: str, models: Sequence[str]) -> Figure:
    """Return the error of every test in free run, each model a row of points.

    Args:
        tests: all of them.
        unit: of the displacement.
        models: whose errors are drawn, from the bottom up.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.7 + 0.32 * len(models)))
    axis = figure.subplots()
    for place, model in enumerate(models):
        errors = np.where(np.isfinite(tests.rmse(model)), tests.rmse(model), np.nan)
        sign = MARKERS.get(model, "o")
        axis.plot(errors, np.full(errors.size, place), sign, color=COLOURS[model], markersize=4, alpha=0.6)
        with np.errstate(over="ignore", invalid="ignore"):
            overall = float(np.sqrt(np.average(errors**2, weights=[row.size for row in tests.actual])))
        axis.plot([overall], [place], "|", color=INK, markersize=12, markeredgewidth=1.2)
    axis.set_yticks(range(len(models)), [LABELS[model].partition(", free")[0] for model in models])
    axis.set_ylim(-0.6, len(models) - 0.4)
    logarithmic(axis.xaxis)
    axis.set_xlabel(f"RMSE of each test in free run / {unit}")
    return figure


@styled
def horizons(known: Mapping[str, Any], step_s: float, unit: str) -> Figure:
    """Return the error over how far is looked ahead.

    Args:
        known: `horizons` of one direction, as `metrics.json` holds them.
        step_s: sampling time, s.
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 3.0))
    axis = figure.subplots()
    ahead_s = step_s * np.array(known["steps"])
    for model, values in known.items():
        if model == "steps":
            continue
        errors = np.array([np.nan if value is None else value for value in values])
        main = model in ("greybox", "benchmark", "persistence")
        axis.plot(
            ahead_s,
            errors,
            marker=MARKERS.get(model, "o"),
            color=COLOURS[model],
            dashes=DASHES.get(model, (None, None)),
            markersize=3.5 if main else 2.5,
            linewidth=1.6 if model == "greybox" else 0.9,
            label=LABELS[model].partition(", free")[0],
            zorder=3 if main else 2,
        )
    logarithmic(axis.xaxis)
    logarithmic(axis.yaxis)
    axis.set_xlabel("looked ahead / s")
    axis.set_ylabel(f"RMSE / {unit}")
    legend_above(figure, axis)
    return figure


def end_to_end(tests: Sequence[np.ndarray]) -> np.ndarray:
    """Return tests one after another; NaN in place of the first sample, which is given, parts them."""
    return np.concatenate([np.append(np.nan, test[1:]) for test in tests])


def joined_time(tests: Predictions) -> np.ndarray:
    """Return the time of tests laid end to end, s."""
    parts, start = [], 0.0
    for time_s in tests.time_s:
        parts.append(start + time_s)
        start += float(time_s[-1])
    return np.concatenate(parts)


def _coarse(smooth: np.ndarray) -> np.ndarray:
    """Return places of samples enough to draw what is smooth, with the gaps and what borders them."""
    gaps = np.flatnonzero(np.isnan(smooth))
    kept = np.concatenate([np.arange(0, smooth.size, max(1, smooth.size // 300)), gaps, gaps - 1, gaps + 1])
    return np.unique(kept[(kept >= 0) & (kept < smooth.size)])


def _predicted(part: str, parts: int) -> str:
    return f"predicted one step ahead{f', {part}' if parts > 1 else ''}"


def _squares(errors: np.ndarray) -> bool:
    """Tell whether errors have a mean square; those of what diverged have none."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.sum(errors**2)))


def _histogram(axis: Axes, errors: np.ndarray, reach: float, colour: str, label: str) -> None:
    mean, spread = float(errors.mean()), float(errors.std())
    inside = errors[np.abs(errors) <= reach]
    bins = np.linspace(-reach, reach, 61)
    weights = np.full(inside.size, 1.0 / (errors.size * (bins[1] - bins[0])))
    axis.hist(inside, bins=bins.tolist(), weights=weights, color=colour, alpha=0.2)
    if spread > 0:
        place = np.linspace(-reach, reach, 200)
        bell = np.exp(-0.5 * ((place - mean) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        axis.plot(place, bell, color=colour, linewidth=0.9, label=label)
    else:
        axis.plot([mean], [0], "o", color=colour, markersize=3, label=label, clip_on=False)
