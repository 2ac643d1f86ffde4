"""Section on mixed cycles of lifting, holding and lowering."""

from hitchid.report import figure_data, figures
from hitchid.report.document import Picture, Pictures, ReportSection
from hitchid.report.tables import cycle_tables
from hitchid.validation import Accuracy
from hitchid.validation.shown_tests import shown_tests

MODELS = ("benchmark", "free_run")


def cycles(accuracy: Accuracy, step_s: float, unit: str) -> ReportSection:
    """Return the section on mixed cycles.

    Args:
        accuracy: on the unseen cycles.
        step_s: sampling time, s.
        unit: of the displacement.
    """
    tests = accuracy.predictions
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    model_errors = {name: tests.errors(name) for name in reversed(MODELS)}
    first_table, *others = cycle_tables(accuracy, unit)
    pictures = (
        Picture(
            "cycles-outputs",
            figures.outputs(selected_tests, unit, MODELS),
            f"Measured and predicted displacement, and errors: {selection_text.replace('test', 'cycle')} "
            f"({names}).",
            f"Displacement and error over time of {names}, free run.",
            data=figure_data.outputs(selected_tests, unit, MODELS),
        ),
        Picture(
            "cycles-distribution",
            figures.error_distribution(model_errors, unit),
            "Errors on all unseen cycles in free run.",
            f"Histogram and cumulative distribution of errors in {unit}.",
            data=figure_data.errors(model_errors, unit),
        ),
        Picture(
            "cycles-horizons",
            figures.horizons(accuracy.horizons, step_s, unit),
            "Error over the prediction horizon, including changes of direction.",
            f"RMSE in {unit} over the horizon.",
            data=figure_data.horizons(accuracy.horizons, step_s, unit),
        ),
    )
    return ReportSection("Mixed cycles", (first_table, Pictures(pictures), *others))
