"""Report of a comparison: errors of models in common tables and figures."""

from collections.abc import Sequence
from operator import itemgetter

import numpy as np

from hitchid._support import numbers
from hitchid._support.tables import Column, RecordTable
from hitchid.model import Estimate
from hitchid.plots.style import COMPARED
from hitchid.report import figures
from hitchid.report.document import (
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Signals,
    Table,
    sentence,
)
from hitchid.report.origin import command_section
from hitchid.validation import Horizons, LeaderboardRow, ModelComparison, Standing
from hitchid.validation.estimate_tables import estimate_text
from hitchid.validation.results import CYCLES, GREYBOX, MIN_TESTS, PERSISTENCE, RUNS, shown_tests
from hitchid.validation.tables import error_columns, summary_table

# Tables of models side by side: leaderboard, errors, horizons, parameters.


def comparison_models(comparison: ModelComparison) -> Table:
    """Return the letter and the name of each model."""
    rows = tuple(
        (f"model {label}", name) for label, name in zip(comparison.labels, comparison.names, strict=True)
    )
    return Table("models", ("model", "name"), rows)


def leaderboard_table(comparison: ModelComparison, section: str) -> Table:
    """Return the models of one section by their error in free run, and their difference from the best."""
    rows = comparison.leaderboard().section(section)
    header = (
        "model",
        "rank",
        f"free run: RMSE / {comparison.unit}",
        "free run: fit / %",
        f"one step: RMSE / {comparison.unit}",
        "difference from the best",
    )
    cells = tuple(
        (
            f"model {row.label}",
            str(row.rank),
            numbers.with_error(row.free_run.rmse, row.free_run.rmse_error),
            numbers.with_error(row.free_run.fit, row.free_run.fit_error),
            "" if row.one_step is None else numbers.with_error(row.one_step.rmse, row.one_step.rmse_error),
            row.standing.value
            if row.tested is None
            else f"{row.standing.value}, {numbers.p_value(row.tested)}",
        )
        for row in rows
    )
    tests = numbers.count(rows[0].tests, "test")
    return Table(f"{section}: leaderboard over {tests} that no model has used", header, cells)


def comparison_accuracy(comparison: ModelComparison, section: str) -> Table:
    """Return the errors of every model."""
    names = (Column(label="model", value=itemgetter(0)), Column(label="run", value=itemgetter(1)))
    records = tuple(
        (f"model {label}", run_label, figures)
        for run, run_label in reversed(RUNS.items())
        for label, accuracy in zip(comparison.labels, comparison.accuracy(section), strict=True)
        if (figures := accuracy.models[GREYBOX].run(run)) is not None
    )
    tests = numbers.count(len(comparison.accuracy(section)[0].tests), "test")
    title = f"{section}: accuracy on {tests} that no model has used"
    return RecordTable("", title, (*names, *error_columns(comparison.unit)), records).shown()


def comparison_horizons(comparison: ModelComparison, section: str) -> Table:
    """Return the RMSE of every model over each horizon."""
    all_horizons = [accuracy.horizons for accuracy in comparison.accuracy(section)]
    rows = tuple(
        (f"model {label}", *map(numbers.digits, horizons.rmse[GREYBOX]))
        for label, horizons in zip(comparison.labels, all_horizons, strict=True)
    )
    title = f"{section}: RMSE / {comparison.unit} over the horizon in samples"
    return Table(title, ("model", *map(str, all_horizons[0].steps)), rows)


def comparison_parameters(comparison: ModelComparison) -> list[Table]:
    """Return the parameters of every model, for directions with estimates."""
    all_tables = []
    for direction in (name for name in comparison.sections if name != CYCLES):
        all_estimates = [
            {estimate.name: estimate for estimate in parameters.parameters} if parameters else {}
            for parameters in (validation.channels[direction].parameters for validation in comparison)
        ]
        names = dict.fromkeys(name for estimates in all_estimates for name in estimates)
        rows = [
            (name.replace("_", " "), *(_cell(estimates.get(name)) for estimates in all_estimates))
            for name in names
        ]
        if rows:
            header = ("parameter", *(f"model {label}" for label in comparison.labels))
            all_tables.append(Table(f"{direction}: parameters", header, tuple(rows)))
    return all_tables


def _cell(estimate: Estimate | None) -> str:
    """Return a parameter as `K = 39.4 ± 0.6 mm/(s·A)`, or the verdict on one that is not determined."""
    if estimate is None:
        return "not in the model"
    if not estimate.determined:
        return estimate.verdict
    return f"{estimate.symbol} = {numbers.with_unit(estimate_text(estimate), estimate.unit)}"


def comparison_report(comparison: ModelComparison, *, command: str = "") -> Document:
    """Return the report of a comparison.

    Args:
        comparison: models on tests that none of their identifications used.
        command: the command line that wrote the report.
    """
    parameters = comparison_parameters(comparison)
    models = zip(comparison.labels, comparison.names, strict=True)
    return Document(
        title=f"Comparison of {numbers.count(len(comparison), 'model')}",
        subtitle="; ".join(f"{label}: {name}" for label, name in models),
        verdict=tuple(
            Finding(
                Rating.CAUTION if comparison.verdict(section).better is None else Rating.GOOD,
                sentence(f"{section}: {verdict_text(comparison, section)}"),
            )
            for section in comparison.sections
        ),
        notices=tuple(map(sentence, comparison.notices)),
        sections=(
            *(_section(comparison, section) for section in comparison.sections),
            *([ReportSection("Parameters", tuple(parameters))] if parameters else []),
            command_section(command),
        ),
        summary=tuple(_summary(comparison, section) for section in comparison.sections),
        data=comparison.metrics,
        data_tables=comparison.tables(),
        signals=Signals(
            {section: comparison.free_runs(section) for section in comparison.sections},
            comparison.unit,
            comparison.validations[0].model.units,
        ),
    )


def comparison_tables(comparison: ModelComparison) -> Document:
    """Return every table of a comparison, the content of `tables.md`."""
    table_list = [comparison_models(comparison)]
    for section in comparison.sections:
        table_list += [
            leaderboard_table(comparison, section),
            comparison_accuracy(comparison, section),
            comparison_horizons(comparison, section),
        ]
    table_list += comparison_parameters(comparison)
    verdicts = (f"{section}: {verdict_text(comparison, section)}" for section in comparison.sections)
    return Document(
        title="Comparison",
        notices=(*verdicts, *comparison.notices),
        sections=(ReportSection("", tuple(table_list)),),
        data=comparison.metrics,
    )


def verdict_text(comparison: ModelComparison, section: str) -> str:
    """Return the model with the smallest error in free run and the significance of its difference."""
    rows = comparison.leaderboard().section(section)
    errors = [
        numbers.DIVERGED
        if row.free_run.rmse is None
        else f"{numbers.with_error(row.free_run.rmse, row.free_run.rmse_error)} {comparison.unit}"
        for row in rows
    ]
    with_labels = (f"{error} with {row.label}" for error, row in zip(errors, rows, strict=True))
    errors_text = f"RMSE {', '.join(with_labels)}"
    best, tests = rows[0], numbers.count(rows[0].tests, "test")
    worse, similar = (
        _listed([row.label for row in rows if row.standing is standing])
        for standing in (Standing.WORSE, Standing.SIMILAR)
    )
    if best.tests < MIN_TESTS:
        return f"{_smallest(comparison, section, rows)}; too few for a test of significance: {errors_text}"
    if not worse:
        return f"{_smallest(comparison, section, rows)}; not significant: {errors_text}"
    better = f"{best.label} has a significantly smaller error in free run than {worse}"
    if similar:
        return f"{better}, and is not distinguishable from {similar}, over {tests}: {errors_text}"
    wins = comparison.verdict(section).wins
    return f"{better}, the smallest on {wins} of {tests}: {errors_text}"


def _smallest(comparison: ModelComparison, section: str, rows: Sequence[LeaderboardRow]) -> str:
    """Return on how many tests the first model has the smallest error, and by which factor over all."""
    runs, best = comparison.free_runs(section), rows[0].label
    others = np.min([runs.rmse(row.label) for row in rows[1:]], axis=0)
    wins = int(np.sum(runs.rmse(best) < others))
    tests = numbers.count(rows[0].tests, "test")
    own, second = rows[0].free_run.rmse, rows[1].free_run.rmse
    if own == second:
        return f"{best} and {rows[1].label} have the same error in free run over {tests}"
    factor = (
        f", over all {second / own:.3g} times smaller than that of {rows[1].label}" if own and second else ""
    )
    return f"{best} has the smallest error in free run on {wins} of {tests}{factor}"


def _listed(labels: Sequence[str]) -> str:
    """Return labels as `B`, `B and C`, `B, C and D`; empty for none."""
    return " and ".join(filter(None, (", ".join(labels[:-1]), *labels[-1:])))


def _summary(comparison: ModelComparison, section: str) -> Table:
    accuracies = zip(comparison.labels, comparison.accuracy(section), strict=True)
    models = [(f"model {label}", accuracy.models[GREYBOX]) for label, accuracy in accuracies]
    return summary_table(section, models, comparison.unit)


def _section(comparison: ModelComparison, section: str) -> ReportSection:
    blocks = (
        leaderboard_table(comparison, section),
        comparison_accuracy(comparison, section),
        comparison_horizons(comparison, section),
        Pictures(tuple(_pictures(comparison, section))),
    )
    return ReportSection(section.capitalize(), blocks)


def _pictures(comparison: ModelComparison, section: str) -> list[Picture]:
    """Return the figures of one section, with at most the first eight models."""
    unit, tests = comparison.unit, comparison.free_runs(section)
    labels = [label for label in comparison.labels if label in COMPARED]
    selected_tests, selection_text = shown_tests(tests, labels[-1])
    names = ", ".join(selected_tests.names)
    models_text = "all models" if len(labels) == len(comparison) else f"models {labels[0]} to {labels[-1]}"
    by_label = dict(zip(comparison.labels, comparison.accuracy(section), strict=True))
    first = by_label[comparison.labels[0]].horizons
    horizons = {label: by_label[label].horizons.rmse[GREYBOX] for label in labels}
    horizons = Horizons(first.steps, {PERSISTENCE: first.rmse[PERSISTENCE], **horizons})
    errors = {label: tests.errors(label) for label in labels}
    pictures = [
        figures.outputs(
            f"{section}-overlay",
            selected_tests,
            unit,
            labels,
            f"Free runs of {models_text} and their errors: {selection_text} ({names}).",
            f"Displacement and error over time of {names} for {models_text}.",
        )
    ]
    if all(np.all(np.isfinite(rows)) for rows in errors.values()):
        pictures.append(
            figures.error_distribution(
                f"{section}-distribution",
                errors,
                unit,
                "Errors in free run on all tests.",
                f"Distribution of errors in {unit} for {models_text}.",
            )
        )
    return [
        *pictures,
        figures.horizons(
            f"{section}-horizons",
            horizons,
            comparison.step_s,
            unit,
            "Error over the prediction horizon.",
            f"RMSE in {unit} over the horizon for {models_text}.",
        ),
        figures.errors_by_test(
            f"{section}-tests",
            tests,
            unit,
            labels[::-1],
            "RMSE of each test in free run; the bar is the RMSE over all tests.",
            f"RMSE of each of {len(tests.names)} tests for {models_text}.",
        ),
    ]
