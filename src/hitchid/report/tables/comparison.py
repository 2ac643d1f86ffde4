"""Tables of models side by side: leaderboard, errors, horizons, parameters."""

from hitchid.model import Estimate
from hitchid.report import numbers
from hitchid.report.document import Table
from hitchid.report.tables.accuracy import error_header
from hitchid.validation import LeaderboardRow, ModelComparison
from hitchid.validation.names import CYCLES, GREYBOX, RUNS


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
            _difference(row),
        )
        for row in rows
    )
    tests = numbers.count(rows[0].tests, "test")
    return Table(f"{section}: leaderboard over {tests} that no model has used", header, cells)


def comparison_accuracy(comparison: ModelComparison, section: str) -> Table:
    """Return the errors of every model."""
    rows = tuple(
        (f"model {label}", run_label, *numbers.error_cells(figures))
        for run, run_label in reversed(RUNS.items())
        for label, accuracy in zip(comparison.labels, comparison.accuracy(section), strict=True)
        if (figures := accuracy.models[GREYBOX].run(run)) is not None
    )
    tests = numbers.count(len(comparison.accuracy(section)[0].tests), "test")
    title = f"{section}: accuracy on {tests} that no model has used"
    return Table(title, error_header(comparison.unit, "model", "run"), rows)


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


def _difference(row: LeaderboardRow) -> str:
    if row.tested is None:
        return row.standing.value
    return f"{row.standing.value}, {numbers.p_value(row.tested)}"


def _cell(estimate: Estimate | None) -> str:
    """Return a parameter as `K = 39.4 ± 0.6 mm/(s·A)`, or the verdict on one that is not determined."""
    if estimate is None:
        return "not in the model"
    if not estimate.determined:
        return estimate.verdict
    return f"{estimate.symbol} = {numbers.with_unit(numbers.estimate(estimate), estimate.unit)}"
