"""Mixed cycles: how a model does where lifting, holding and lowering alternate."""

from collections.abc import Mapping
from typing import Any

from hitchid.report import figures
from hitchid.report.document import Picture, Pictures, ReportSection
from hitchid.report.sections.direction import shown_tests
from hitchid.validation import Predictions
from hitchid.validation.tables import cycle_tables

MODELS = ("benchmark", "free_run")


def cycles(metrics: Mapping[str, Any], tests: Predictions, step_s: float, unit: str) -> ReportSection:
    """Return the section on mixed cycles.

    Args:
        metrics: `cycles` of `metrics.json`.
        tests: the unseen cycles with what the model says of them.
        step_s: sampling time, s.
        unit: of the displacement.
    """
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    accuracy, *others = cycle_tables(metrics, unit)
    pictures = (
        Picture(
            "cycles-outputs",
            figures.outputs(selected_tests, unit, MODELS),
            f"Measured and predicted displacement, and errors: {selection_text.replace('test', 'cycle')} ({names}).",
            f"Displacement and error over time of {names}, free run.",
        ),
        Picture(
            "cycles-distribution",
            figures.error_distribution({name: tests.errors(name) for name in reversed(MODELS)}, unit),
            "Errors on all unseen cycles in free run.",
            f"Histogram and cumulative distribution of errors in {unit}.",
        ),
        Picture(
            "cycles-horizons",
            figures.horizons(metrics["horizons"], step_s, unit),
            "Error over how far is looked ahead, across switches of direction.",
            f"RMSE in {unit} over the horizon.",
        ),
    )
    return ReportSection("Mixed cycles", (accuracy, Pictures(pictures), *others))
