"""Tables of two models side by side: errors, horizons, parameters."""

from hitchid.model import Estimate
from hitchid.report import numbers
from hitchid.report.document import Table
from hitchid.report.tables.accuracy import error_header
from hitchid.validation import ModelComparison
from hitchid.validation.comparison import MODELS
from hitchid.validation.names import CYCLES, GREYBOX, RUNS


def comparison_accuracy(comparison: ModelComparison, section: str) -> Table:
    """Return the errors of both models."""
    pair = comparison.accuracy(section)
    rows = tuple(
        (f"model {name}", label, *numbers.error_cells(figures))
        for run, label in reversed(RUNS.items())
        for name, accuracy in zip(MODELS, pair, strict=True)
        if (figures := accuracy.models[GREYBOX].run(run)) is not None
    )
    tests = numbers.count(len(pair[0].tests), "test")
    title = f"{section}: accuracy on {tests} that neither has seen"
    return Table(title, error_header(comparison.unit, "model", "run"), rows)


def comparison_horizons(comparison: ModelComparison, section: str) -> Table:
    """Return the RMSE of both models over each horizon."""
    pair = [accuracy.horizons for accuracy in comparison.accuracy(section)]
    rows = tuple(
        (f"model {name}", *map(numbers.digits, horizons.rmse[GREYBOX]))
        for name, horizons in zip(MODELS, pair, strict=True)
    )
    title = f"{section}: RMSE / {comparison.unit} over the horizon in samples"
    return Table(title, ("model", *map(str, pair[0].steps)), rows)


def comparison_parameters(comparison: ModelComparison) -> list[Table]:
    """Return the parameters of both models, for directions with estimates."""
    all_tables = []
    for direction in (name for name in comparison.sections if name != CYCLES):
        pair = [
            {estimate.name: estimate for estimate in result.parameters.parameters}
            if result.parameters
            else {}
            for result in (comparison.first.channels[direction], comparison.second.channels[direction])
        ]
        names = dict.fromkeys([*pair[0], *pair[1]])
        rows = [
            (name.replace("_", " "), *(_cell(estimates.get(name)) for estimates in pair)) for name in names
        ]
        if rows:
            header = ("parameter", *(f"model {name}" for name in MODELS))
            all_tables.append(Table(f"{direction}: parameters", header, tuple(rows)))
    return all_tables


def _cell(estimate: Estimate | None) -> str:
    """Return a parameter as `K = 39.4 ± 0.6 mm/(s·A)`, or the verdict on one that is not determined."""
    if estimate is None:
        return "not in the model"
    if not estimate.determined:
        return estimate.verdict
    return f"{estimate.symbol} = {numbers.with_unit(numbers.estimate(estimate), estimate.unit)}"
