"""Errors of one direction: every model, over horizons, by test, distribution."""

from hitchid.report import figure_data, figures
from hitchid.report.document import Picture, Pictures, ReportSection
from hitchid.report.figures.errors import MAX_SAMPLES
from hitchid.report.sections.context import DirectionContext
from hitchid.report.sections.overview import simulated_models
from hitchid.report.tables import accuracy_table, horizon_table, single_test_table
from hitchid.validation.names import BENCHMARK, FREE_RUN, LABELS

COMPARED_MODELS = ("lstm", "narx", "oe", "arx", "transfer_function", BENCHMARK, FREE_RUN)


def accuracy(context: DirectionContext) -> ReportSection:
    """Return the section on the errors of the model and of every baseline."""
    result, unit, tests = context.accuracy, context.unit, context.accuracy.predictions
    unlabelled = [name for name in tests.models if name not in LABELS]
    models = [*unlabelled, *(name for name in COMPARED_MODELS if name in tests.models)]
    pictures = (
        Picture(
            context.figure_name("horizons"),
            figures.horizons(result.horizons, context.step_s, unit),
            "Error over the prediction horizon. A useful model is below persistence.",
            f"RMSE in {unit} over the horizon for each model, from one sample on.",
            data=figure_data.horizons(result.horizons, context.step_s, unit),
        ),
        Picture(
            context.figure_name("tests"),
            figures.errors_by_test(tests, unit, models),
            "RMSE of each unseen test in free run; the bar is the RMSE over all tests.",
            f"RMSE of each of {len(tests.names)} tests in free run, for {len(models)} models.",
            data=figure_data.errors_by_test(tests, unit, models),
        ),
    )
    tables = (accuracy_table(context.direction, result, unit), horizon_table(context.direction, result, unit))
    return ReportSection("Accuracy", (*tables, Pictures(pictures)))


def errors(context: DirectionContext) -> ReportSection:
    """Return the section on the distribution of the errors, and on single tests."""
    tests, unit = context.accuracy.predictions, context.unit
    models = simulated_models(tests)
    model_errors = {name: tests.errors(name) for name in reversed(models)}
    pictures = [
        Picture(
            context.figure_name("distribution"),
            figures.error_distribution(model_errors, unit),
            "Errors on all unseen tests: histogram with fitted normal, and the share of samples below a "
            "limit. The axes end where 99.5 % of the samples lie.",
            f"Histogram and cumulative distribution of errors in {unit}.",
            data=figure_data.errors(model_errors, unit),
        ),
    ]
    if context.data.channel.compensator is not None:
        pictures.append(
            Picture(
                context.figure_name("predicted-errors"),
                figures.predicted_errors({"test": tests}, unit),
                "Error of the physics model, and the LSTM correction's prediction of it one step ahead.",
                f"Error of the physics model in {unit} over the samples, actual and predicted.",
                data=figure_data.predicted_errors({"test": tests}, unit, MAX_SAMPLES),
            )
        )
    table = single_test_table(context.direction, context.accuracy, unit)
    return ReportSection("Errors", (Pictures(tuple(pictures)), table))
