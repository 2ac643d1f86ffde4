"""Figures of an identification: convergence, comparison of searches, losses, comparison of structures."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hitchid._support.inert import printable
from hitchid.model import SearchSummary
from hitchid.model.trace import TracedCandidate, TracedSearch, TracedTraining
from hitchid.plots.style import (
    COLOURS,
    COLUMN_IN,
    FAINT,
    INK,
    finite_or_nan,
    legend_above,
    logarithmic,
    styled,
)
from hitchid.report.document import Picture

SEARCH_COLOURS = {"whale": "one_step", "differential-evolution": "benchmark", "multi-start": "greybox"}
WRAP = 24  # characters per line of the name of a structure; chosen


@styled
def convergence(name: str, search: TracedSearch, unit: str, caption: str, alt: str) -> Picture:
    """Return best fitness and each parameter over the iterations of the search (paper, Fig. 5 and 6).

    Args:
        name, caption, alt: of the picture.
        search: parameter search of one direction.
        unit: of the displacement.
    """
    parameters = search.parameters
    fitness = finite_or_nan(search.fitness)
    iteration = np.arange(1, fitness.size + 1)
    figure = Figure(figsize=(COLUMN_IN, 0.5 + 0.78 * (1 + len(parameters))))
    axes = np.atleast_1d(figure.subplots(1 + len(parameters), 1, sharex=True))
    axes[0].plot(iteration, fitness, color=COLOURS["benchmark"])
    axes[0].set_ylabel(f"RMSE\n/ {unit}")
    logarithmic(axes[0].yaxis)
    data = {"iteration": iteration, f"rmse_{unit}": search.fitness}
    for axis, parameter, values in zip(axes[1:], parameters, np.array(search.values).T, strict=True):
        data[parameter.name] = values
        axis.plot(iteration, values, color=COLOURS["one_step"], label="best so far")
        axis.axhline(parameter.value, color=INK, linewidth=0.7, linestyle=":", label="after least squares")
        unit_suffix = "" if parameter.unit == "1" else f"\n/ {parameter.unit}"
        axis.set_ylabel(f"{parameter.symbol or parameter.name.replace('_', ' ')}{unit_suffix}")
        if not parameter.linear:
            logarithmic(axis.yaxis)
    legend_above(figure, *axes[1:])
    axes[-1].set_xlabel("iteration")
    figure.align_ylabels()
    return Picture(name, figure, caption, alt, data=data)


@styled
def searches(name: str, results: Sequence[SearchSummary], unit: str) -> Picture:
    """Return the final error of several searches from several seeds, and the convergence of the median run.

    Args:
        name: of the picture.
        results: of one direction.
        unit: of the displacement.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.6))
    history_axis, final_axis = figure.subplots(1, 2, sharey=True, width_ratios=[2, 1])
    data = {}
    for index, result in enumerate(results):
        colour = COLOURS[SEARCH_COLOURS.get(result.name, "faint")]
        budget = np.linspace(0, 100, len(result.median_rmse))
        history_axis.plot(budget, finite_or_nan(result.median_rmse), color=colour, label=result.name)
        final_errors = [value for value in result.rmse if value is not None]
        final_axis.plot([index] * len(final_errors), final_errors, "o", color=colour, markersize=3, alpha=0.7)
        data |= {
            f"{result.name}_budget_percent": budget,
            f"{result.name}_median_run_rmse_{unit}": result.median_rmse,
            f"{result.name}_final_rmse_{unit}": result.rmse,
        }
    logarithmic(history_axis.yaxis)
    history_axis.set_xlabel("evaluations used / %")
    history_axis.set_ylabel(f"best RMSE / {unit}")
    final_axis.set_xticks(range(len(results)), [""] * len(results))
    final_axis.set_xlim(-0.6, len(results) - 0.4)
    final_axis.set_xlabel("ends")
    legend_above(figure, history_axis)
    return Picture(
        name,
        figure,
        "Searches with equal evaluations: the median run, and the final error of each seed.",
        f"Best RMSE over the evaluations for {', '.join(result.name for result in results)}.",
        data=data,
    )


@styled
def losses(name: str, training: TracedTraining) -> Picture:
    """Return the loss of the compensator's training on training and validation tests over the epochs.

    Args:
        name: of the picture.
        training: of the compensator of one direction.
    """
    figure = Figure(figsize=(COLUMN_IN, 2.2))
    axis = figure.subplots()
    curves = (
        ("training", training.training_loss, "one_step"),
        ("validation", training.validation_loss, "transfer_function"),
    )
    for subset, loss, colour in curves:
        epochs = np.arange(1, len(loss) + 1)
        axis.plot(epochs, finite_or_nan(loss), color=COLOURS[colour], label=subset)
    axis.axvline(training.best_epoch, color=FAINT, linewidth=0.8, linestyle="--", label="kept")
    logarithmic(axis.yaxis)
    axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel("epoch")
    axis.set_ylabel("loss, errors scaled to 1")
    legend_above(figure, axis, columns=3)
    return Picture(
        name,
        figure,
        "Training of the LSTM correction; the epoch with the smallest validation loss is used.",
        f"Losses over epochs; epoch {training.best_epoch} is used.",
        data={
            "epoch": np.arange(1, max(len(training.training_loss), len(training.validation_loss)) + 1),
            "training_loss": training.training_loss,
            "validation_loss": training.validation_loss,
        },
    )


@styled
def structures(
    name: str, candidates: Sequence[TracedCandidate], unit: str, choice_held_out_rmse: float | None
) -> Picture:
    """Return the compared model specifications: RMSE on all tests, and cross-validated by operating point.

    Args:
        name: of the picture.
        candidates: of one direction.
        unit: of the displacement.
        choice_held_out_rmse: on levels that neither fitted nor chose the structure; None where none were.
    """
    figure = Figure(figsize=(COLUMN_IN, 0.8 + 0.33 * len(candidates)))
    axis = figure.subplots()
    row_positions = np.arange(len(candidates))[::-1]
    rmse = [candidate.rmse for candidate in candidates]
    held_out = [candidate.held_out_rmse for candidate in candidates]
    for values, sign, colour, inside, label in (
        (rmse, "o", INK, "none", "all tests"),
        (held_out, "D", COLOURS["benchmark"], "full", "cross-validation over levels"),
    ):
        axis.plot(
            finite_or_nan(values),
            row_positions,
            sign,
            color=colour,
            fillstyle=inside,
            markersize=4,
            label=label,
        )
    names = [f"{candidate.name}{' (chosen)' if candidate.chosen else ''}" for candidate in candidates]
    axis.set_yticks(row_positions, [fill(printable(name), WRAP) for name in names])
    axis.set_ylim(-0.6, len(candidates) - 0.4)
    logarithmic(axis.xaxis)
    axis.set_xlabel(f"RMSE in free run / {unit}")
    legend_above(figure, axis)
    caption = (
        "Free-run RMSE of each structure, on all tests and in cross-validation over levels. A larger "
        "structure is taken where it is significantly better in cross-validation, as shown or with a gain "
        "fitted to each test, which this figure does not include; in the other of the two it must not be "
        "significantly worse."
    )
    if choice_held_out_rmse is not None:
        error = f"{choice_held_out_rmse:.4g} {unit}"
        caption += f" On levels that neither fitted nor chose the structure: {error}."
    chosen = next(candidate.name for candidate in candidates if candidate.chosen)
    data = {
        "structure": [candidate.name for candidate in candidates],
        f"rmse_{unit}": rmse,
        f"held_out_rmse_{unit}": held_out,
        f"held_out_rmse_per_test_gain_{unit}": [
            candidate.held_out_rmse_per_test_gain for candidate in candidates
        ],
        "chosen": [candidate.chosen for candidate in candidates],
    }
    alt = f"RMSE of {len(candidates)} structures; chosen: {chosen}."
    return Picture(name, figure, caption, alt, data=data)
