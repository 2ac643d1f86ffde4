"""Report of a comparison: errors of two models in common tables and figures."""

import numpy as np

from hitchid.report import figure_data, figures, numbers, sections, tables
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
from hitchid.validation import Horizons, ModelComparison
from hitchid.validation.comparison import MODELS
from hitchid.validation.names import GREYBOX, PERSISTENCE
from hitchid.validation.predictions import MIN_TESTS


def comparison_report(comparison: ModelComparison, *, names: tuple[str, str], command: str = "") -> Document:
    """Return the report of a comparison.

    Args:
        comparison: the two models on tests that neither identification used.
        names: of the models A and B.
        command: the command line that wrote the report.
    """
    parameters = tables.comparison_parameters(comparison)
    return Document(
        title="Comparison of two hitch models",
        subtitle=f"A: {names[0]}; B: {names[1]}",
        verdict=tuple(_finding(comparison, section) for section in comparison.sections),
        notices=tuple(map(sentence, comparison.notices)),
        sections=(
            *(_section(comparison, section) for section in comparison.sections),
            *([ReportSection("Parameters", tuple(parameters))] if parameters else []),
            ReportSection("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),)),
        ),
        summary=tuple(_summary(comparison, section) for section in comparison.sections),
        data=comparison.metrics,
        data_tables=comparison.tables(),
        signals=_signals(comparison),
    )


def comparison_tables(comparison: ModelComparison) -> Document:
    """Return every table of a comparison, the content of `tables.md`."""
    table_list: list[Table] = []
    for section in comparison.sections:
        table_list += [
            tables.comparison_accuracy(comparison, section),
            tables.comparison_horizons(comparison, section),
        ]
    table_list += tables.comparison_parameters(comparison)
    verdicts = (f"{section}: {verdict_text(comparison, section)}" for section in comparison.sections)
    return Document(
        title="Comparison",
        notices=(*verdicts, *comparison.notices),
        sections=(ReportSection("", tuple(table_list)),),
        data=comparison.metrics,
    )


def verdict_text(comparison: ModelComparison, section: str) -> str:
    """Return which model has the smaller error in free run, or that the difference is not significant."""
    runs = [accuracy.free_run() for accuracy in comparison.accuracy(section)]
    a, b = (
        numbers.DIVERGED
        if run.rmse is None
        else f"{numbers.with_error(run.rmse, run.rmse_error)} {comparison.unit}"
        for run in runs
    )
    figures_text = f"RMSE {a} with A, {b} with B"
    verdict = comparison.verdict(section)
    if verdict.tests < MIN_TESTS:
        tests = numbers.count(verdict.tests, "test")
        return f"{tests}, too few to tell the models apart in free run: {figures_text}"
    if verdict.better is None:
        return f"{verdict.tests} tests do not tell the models apart in free run: {figures_text}"
    wins = f"on {verdict.wins} of {verdict.tests} tests"
    return f"{verdict.better} errs less in free run, {wins}: {figures_text}"


def _signals(comparison: ModelComparison) -> Signals:
    tests = {section: comparison.free_runs(section) for section in comparison.sections}
    return Signals(tests, comparison.unit, comparison.first.model.units)


def _finding(comparison: ModelComparison, section: str) -> Finding:
    rating = Rating.CAUTION if comparison.verdict(section).better is None else Rating.GOOD
    return Finding(rating, sentence(f"{section}: {verdict_text(comparison, section)}"))


def _summary(comparison: ModelComparison, section: str) -> Table:
    pairs = zip(MODELS, comparison.accuracy(section), strict=True)
    models = [(f"model {name}", accuracy.models[GREYBOX]) for name, accuracy in pairs]
    return tables.summary_table(section, models, comparison.unit)


def _section(comparison: ModelComparison, section: str) -> ReportSection:
    unit, tests = comparison.unit, comparison.free_runs(section)
    selected_tests, selection_text = sections.shown_tests(tests, "b")
    one, other = (accuracy.horizons for accuracy in comparison.accuracy(section))
    rmse = {PERSISTENCE: one.rmse[PERSISTENCE], "a": one.rmse[GREYBOX], "b": other.rmse[GREYBOX]}
    pictures = [
        Picture(
            f"{section}-overlay",
            figures.outputs(selected_tests, unit, ("a", "b")),
            "Free runs of both models and their errors: "
            f"{selection_text} ({', '.join(selected_tests.names)}).",
            f"Displacement and error over time of {', '.join(selected_tests.names)} for both models.",
            data=figure_data.outputs(selected_tests, unit, ("a", "b")),
        ),
        *_distribution(section, {name: tests.errors(name) for name in "ab"}, unit),
        Picture(
            f"{section}-horizons",
            figures.horizons(Horizons(one.steps, rmse), comparison.step_s, unit),
            "Error over how far is looked ahead.",
            f"RMSE in {unit} over the horizon for both models.",
            data=figure_data.horizons(Horizons(one.steps, rmse), comparison.step_s, unit),
        ),
        Picture(
            f"{section}-tests",
            figures.errors_by_test(tests, unit, ("b", "a")),
            "Error of every test in free run; the bar is the figure over all tests.",
            f"RMSE of each of {len(tests.names)} tests for both models.",
            data=figure_data.errors_by_test(tests, unit, ("b", "a")),
        ),
    ]
    accuracy = tables.comparison_accuracy(comparison, section)
    horizons = tables.comparison_horizons(comparison, section)
    return ReportSection(section.capitalize(), (accuracy, horizons, Pictures(tuple(pictures))))


def _distribution(section: str, errors: dict[str, np.ndarray], unit: str) -> list[Picture]:
    if not all(np.all(np.isfinite(rows)) for rows in errors.values()):
        return []
    return [
        Picture(
            f"{section}-distribution",
            figures.error_distribution(errors, unit),
            "Errors in free run on all tests.",
            f"Distribution of errors in {unit} for both models.",
            data=figure_data.errors(errors, unit),
        )
    ]
