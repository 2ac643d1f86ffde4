"""The paper's Figures 5 to 12, each with the data behind it."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from hitchid.identification import ChannelTrace
from hitchid.record import LIFTING, LOWERING
from hitchid.study.results import DirectionResult, Predictions
from hitchid.study.style import COLOURS, LABELS, MEASURED, PARTS, style

SHOWN = 2000
CONVERGENCE = {LIFTING: 5, LOWERING: 6}
TRAINING = {LIFTING: 7, LOWERING: 8}
DISTRIBUTION = {LIFTING: 9, LOWERING: 10}
TEST = {LIFTING: 11, LOWERING: 12}


class Drawn(NamedTuple):
    """A figure, the number it has in the paper, and the data behind it: column to values."""

    number: int
    title: str
    figure: Figure
    data: Mapping[str, np.ndarray]


def figures(mode: str, trace: ChannelTrace, result: DirectionResult, unit: str) -> list[Drawn]:
    """Return the four figures the paper shows of one direction."""
    with style():
        return [
            convergence(mode, trace, unit),
            predicted_errors(mode, result, unit),
            error_distribution(mode, result, unit),
            test_set(mode, result.test, unit),
        ]


def convergence(mode: str, trace: ChannelTrace, unit: str) -> Drawn:
    """Return best fitness and each parameter over the iterations of the search (paper, Fig. 5 and 6)."""
    found, estimates = trace.phase1.fit.found, trace.phase1.estimates
    values = np.column_stack(
        [estimate.at(column) for estimate, column in zip(estimates, found.best_trace.T, strict=True)]
    )
    iteration = np.arange(1, found.fitness_trace.size + 1)
    figure = Figure(figsize=(6.4, 1.7 * (1 + len(estimates))))
    axes = figure.subplots(1 + len(estimates), 1, sharex=True)
    axes[0].plot(iteration, found.fitness_trace, color=COLOURS["benchmark"])
    axes[0].set_ylabel(f"RMSE / {unit}")
    axes[0].set_yscale("log")
    for axis, estimate, column in zip(axes[1:], estimates, values.T, strict=True):
        axis.plot(iteration, column, color=COLOURS["one_step"])
        axis.axhline(
            estimate.value, color=MEASURED, linewidth=0.7, linestyle="--", label="after least squares"
        )
        axis.set_ylabel(f"{estimate.name.replace('_', ' ')}\n/ {estimate.unit}")
        axis.set_yscale("log")
    for axis in axes:
        low, high = axis.get_ylim()
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0)))
        axis.yaxis.set_minor_locator(NullLocator())
        axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes[1].legend(loc="best")
    axes[-1].set_xlabel("iteration")
    names = {estimate.name: column for estimate, column in zip(estimates, values.T, strict=True)}
    data = {"iteration": iteration, f"rmse_{unit}": found.fitness_trace, **names}
    return Drawn(CONVERGENCE[mode], f"convergence of the search, {mode}", figure, data)


def predicted_errors(mode: str, result: DirectionResult, unit: str) -> Drawn:
    """Return the transfer function's error and its prediction, 2000 samples (paper, Fig. 7 and 8)."""
    figure = Figure(figsize=(6.4, 4.4))
    data: dict[str, np.ndarray] = {}
    for axis, part in zip(figure.subplots(2, 1), ("training", "validation"), strict=True):
        predictions: Predictions = getattr(result, part)
        measured = _end_to_end(predictions.actual)[:SHOWN]
        actual = measured - _end_to_end(predictions.benchmark)[:SHOWN]
        predicted = actual - (measured - _end_to_end(predictions.one_step)[:SHOWN])
        sample = np.arange(actual.size)
        axis.plot(sample, actual, color=MEASURED, label="actual")
        axis.plot(sample, predicted, color=PARTS[part], linestyle="--", label="predicted one step ahead")
        axis.set_ylabel(f"error, {part} / {unit}")
        _legend_above(axis)
        data |= {f"{part}_actual_{unit}": actual, f"{part}_predicted_{unit}": predicted}
        axis.set_xlabel("sample")
    return Drawn(TRAINING[mode], f"transfer function's error, actual and predicted, {mode}", figure, data)


def error_distribution(mode: str, result: DirectionResult, unit: str) -> Drawn:
    """Return histogram and cumulative distribution of the one-step error (paper, Fig. 9 and 10)."""
    figure = Figure(figsize=(6.4, 3.0))
    left, right = figure.subplots(1, 2)
    data: dict[str, np.ndarray] = {}
    for part in ("training", "validation"):
        errors = getattr(result, part).errors("one_step")
        _histogram(left, errors, PARTS[part], part)
        _cumulative(right, errors, PARTS[part], part)
        data[f"{part}_error_{unit}"] = errors
    _distribution_labels(left, right, unit)
    left.legend()
    right.legend(loc="lower right")
    return Drawn(DISTRIBUTION[mode], f"one-step error on training and validation tests, {mode}", figure, data)


def test_set(mode: str, test: Predictions, unit: str) -> Drawn:
    """Return outputs, errors, histogram and distribution on the test set (paper, Fig. 11 and 12)."""
    figure = Figure(figsize=(6.4, 6.4))
    grid = figure.add_gridspec(3, 2)
    outputs, errors = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    left, right = figure.add_subplot(grid[2, 0]), figure.add_subplot(grid[2, 1])
    time_s, measured = _joined_time(test), _end_to_end(test.actual)
    outputs.plot(time_s, measured, color=MEASURED, label="measured")
    data = {"time_s": time_s, f"measured_{unit}": measured}
    for model, label in LABELS.items():
        predicted = _end_to_end(test.of(model))
        outputs.plot(time_s, predicted, color=COLOURS[model], linestyle="--", label=label)
        errors.plot(time_s, measured - predicted, color=COLOURS[model], linewidth=0.8)
        _histogram(left, test.errors(model), COLOURS[model], label)
        _cumulative(right, test.errors(model), COLOURS[model], label)
        data[f"{model}_{unit}"] = predicted
    outputs.set_ylabel(f"displacement / {unit}")
    errors.set_ylabel(f"error / {unit}")
    errors.set_xlabel("time, test after test / s")
    _legend_above(outputs)
    _distribution_labels(left, right, unit)
    return Drawn(TEST[mode], f"test set, {mode}", figure, data)


def _end_to_end(tests: Sequence[np.ndarray]) -> np.ndarray:
    """Return tests one after another; NaN in place of the first sample, which is given, parts them."""
    return np.concatenate([np.append(np.nan, test[1:]) for test in tests])


def _legend_above(axis: Axes) -> None:
    axis.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=7)


def _joined_time(test: Predictions) -> np.ndarray:
    """Return the time of tests laid end to end, s."""
    parts, start = [], 0.0
    for time_s in test.time_s:
        parts.append(start + time_s)
        start += float(time_s[-1])
    return np.concatenate(parts)


def _histogram(axis: Axes, errors: np.ndarray, colour: str, label: str) -> None:
    mean, spread = float(errors.mean()), float(errors.std())
    axis.hist(errors, bins=60, density=True, color=colour, alpha=0.35, label=label)
    place = np.linspace(errors.min(), errors.max(), 200)
    if spread > 0:
        bell = np.exp(-0.5 * ((place - mean) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        axis.plot(place, bell, color=colour)


def _cumulative(axis: Axes, errors: np.ndarray, colour: str, label: str) -> None:
    sizes = np.sort(np.abs(errors))
    axis.plot(sizes, np.arange(1, sizes.size + 1) / sizes.size, color=colour, label=label)


def _distribution_labels(left: Axes, right: Axes, unit: str) -> None:
    left.set_xlabel(f"error / {unit}")
    left.set_ylabel(f"density / (1/{unit})")
    right.set_xlabel(f"absolute error / {unit}")
    right.set_ylabel("share of samples below")
