"""The report of a comparison: which model errs less, side by side and overlaid."""

import numpy as np

from hitchid.report import figures, sections
from hitchid.report.document import (
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    sentence,
)
from hitchid.validation import ModelComparison, Table


def comparison_report(comparison: ModelComparison, *, names: tuple[str, str], command: str = "") -> Document:
    """Compose what a comparison found for people to read.

    Args:
        comparison: the two models on tests that neither has seen.
        names: what the models are called, A and B.
        command: that wrote the report.
    """
    findings = []
    for subset in comparison.sections:
        better, text = comparison.verdict(subset)
        findings.append(
            Finding(Rating.CAUTION if better is None else Rating.GOOD, sentence(f"{subset}: {text}"))
        )
    parameters = comparison.parameters()
    return Document(
        title="Comparison of two hitch models",
        subtitle=f"A: {names[0]}; B: {names[1]}",
        verdict=tuple(findings),
        notices=tuple(map(sentence, comparison.notices)),
        sections=(
            *(_subset_section(comparison, subset) for subset in comparison.sections),
            *([ReportSection("Parameters", tuple(parameters))] if parameters else []),
            ReportSection("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),)),
        ),
    )


def _subset_section(comparison: ModelComparison, subset: str) -> ReportSection:
    unit, tests = comparison.unit, comparison.free_runs(subset)
    selected_tests, selection_text = sections.shown_tests(tests, "b")
    model_figures = comparison.figures(subset)
    steps = {"steps": model_figures[0]["horizons"]["steps"]}
    horizon_errors = {
        name: model_metrics["horizons"]["greybox"]
        for name, model_metrics in zip("ab", model_figures, strict=True)
    }
    persistence = {"persistence": model_figures[0]["horizons"]["persistence"]}
    rows = {name: tests.errors(name) for name in "ab"}
    finite = all(np.all(np.isfinite(errors)) for errors in rows.values())
    pictures = [
        Picture(
            f"{subset}-overlay",
            figures.outputs(selected_tests, unit, ("a", "b")),
            f"Free runs of both models and their errors: {selection_text} ({', '.join(selected_tests.names)}).",
            f"Displacement and error over time of {', '.join(selected_tests.names)} for both models.",
        ),
        Picture(
            f"{subset}-horizons",
            figures.horizons({**steps, **persistence, **horizon_errors}, comparison.step_s, unit),
            "Error over how far is looked ahead.",
            f"RMSE in {unit} over the horizon for both models.",
        ),
        Picture(
            f"{subset}-tests",
            figures.errors_by_test(tests, unit, ("b", "a")),
            "Error of every test in free run; the bar is the figure over all tests.",
            f"RMSE of each of {len(tests.names)} tests for both models.",
        ),
    ]
    if finite:
        distribution = Picture(
            f"{subset}-distribution",
            figures.error_distribution(rows, unit),
            "Errors in free run on all tests.",
            f"Distribution of errors in {unit} for both models.",
        )
        pictures.insert(1, distribution)
    tables = (comparison.accuracy(subset), comparison.horizons(subset))
    return ReportSection(subset.capitalize(), (*tables, Pictures(tuple(pictures))))
