"""Tables of errors: every model, horizons, single tests, summary."""

from collections.abc import Iterable

from hitchid.report import numbers
from hitchid.report.document import Table
from hitchid.report.tables.trust import band_table
from hitchid.validation import CYCLES, Accuracy, ModelFigures
from hitchid.validation.names import RUNS, in_table_order, model_name


def accuracy_table(direction: str, accuracy: Accuracy, unit: str) -> Table:
    """Return the errors of every model on a direction's unseen tests, one step ahead and in free run."""
    tests = numbers.count(len(accuracy.tests), "unseen test")
    return Table(
        f"{direction}: accuracy on {tests}", error_header(unit, "model", "run"), _model_rows(accuracy)
    )


def error_header(unit: str, *names: str) -> tuple[str, ...]:
    """Return the header over `numbers.error_cells`, after names of the first columns."""
    errors = (f"RMSE / {unit}", f"MAE / {unit}", "R²", "fit / %", f"max abs / {unit}", f"below 1 {unit} / %")
    return (*names, *errors)


def horizon_table(direction: str, accuracy: Accuracy, unit: str) -> Table:
    """Return the RMSE of every model over each horizon."""
    horizons = accuracy.horizons
    rows = [
        (model_name(name), *map(numbers.digits, horizons.rmse[name]))
        for name in in_table_order(horizons.rmse)
    ]
    header = ("model", *map(str, horizons.steps))
    return Table(f"{direction}: RMSE / {unit} over the horizon in samples", header, tuple(rows))


def single_test_table(direction: str, accuracy: Accuracy, unit: str) -> Table:
    """Return the errors of the grey box in free run on every test."""
    rows = tuple((name, *numbers.error_cells(figures)) for name, figures in accuracy.per_test.items())
    return Table(f"{direction}: grey box in free run, test by test", error_header(unit, "test"), rows)


def cycle_tables(accuracy: Accuracy, unit: str) -> list[Table]:
    """Return accuracy, horizons and single tests of the cycles, and the coverage of their bands."""
    title = f"cycles: accuracy over {numbers.count(len(accuracy.tests), 'unseen cycle')}"
    bands = [] if accuracy.bands is None else [band_table(CYCLES, accuracy.bands, unit)]
    return [
        Table(title, error_header(unit, "model", "run"), _model_rows(accuracy)),
        horizon_table(CYCLES, accuracy, unit),
        single_test_table(CYCLES, accuracy, unit),
        *bands,
    ]


def summary_table(title: str, models: Iterable[tuple[str, ModelFigures]], unit: str) -> Table:
    """Return RMSE one step ahead and in free run, fit and largest error in free run, for a terminal."""
    header = (f"{title}, RMSE / {unit}", "one step", "free run", "fit / %", "largest")
    return Table("", header, tuple((name, *_summary_cells(figures)) for name, figures in models))


def _model_rows(accuracy: Accuracy) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (model_name(name), label, *numbers.error_cells(figures))
        for run, label in RUNS.items()
        for name in in_table_order(accuracy.models)
        if (figures := accuracy.models[name].run(run)) is not None
    )


def _summary_cells(figures: ModelFigures) -> tuple[str, ...]:
    step = "" if figures.one_step is None else numbers.error_cells(figures.one_step)[0]
    if figures.free_run is None:
        return step, "", "", ""
    rmse, _, _, fit, largest, _ = numbers.error_cells(figures.free_run)
    return step, rmse, fit, largest
