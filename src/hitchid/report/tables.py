"""Tables of errors: every model, horizons, single tests, summary."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hitchid.model import Characteristics, Estimates, LoadOfTest, LoadScatter, SearchSummary
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report import numbers
from hitchid.report.document import Faint, Table
from hitchid.validation import CYCLES, Accuracy, BandFigures, ModelFigures
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import RUNS, in_table_order, model_name

# Tables of parameters with their intervals, and of operating characteristics.

QUANTITY_TITLES = {
    "dead_zone": "dead zone",
    "flow_begins": "command at which flow starts",
    "delay": "delay (5 %)",
    "response_time": "response time (63 %)",
}


def parameter_table(title: str, estimates: Estimates) -> Table:
    """Return parameters and derived quantities; the value of one that is not determined is faint.

    Where no interval was computed there is only the value."""
    rows = [
        (
            estimate.symbol,
            estimate.unit,
            numbers.estimate(estimate),
            numbers.interval(estimate.interval) if estimate.method != NOT_ASSESSED else "",
            numbers.interval(estimate.bootstrap) if estimate.bootstrap and estimate.determined else "",
            f"{100 * estimate.sensitivity:.3g}" if estimate.method != NOT_ASSESSED else "",
            estimate.verdict,
        )
        for estimate in estimates.parameters
    ]
    rows += [
        (
            quantity.name,
            quantity.unit,
            numbers.quantity(quantity),
            numbers.interval(quantity.interval),
            "",
            "",
            numbers.determined(quantity),
        )
        for quantity in estimates.derived
    ]
    header = (
        "parameter",
        "unit",
        "value ± standard error",
        "95 %",
        "bootstrap",
        "RMSE for ±1 % / %",
        "verdict",
    )
    return Table(title, header, tuple(rows))


def load_table(direction: str, load_scatter: LoadScatter) -> Table:
    """Return the scatter of the speed between tests, and each test's own speed."""

    def row(name: str, value: float, result: LoadScatter | LoadOfTest, verdict: str = "") -> tuple[str, ...]:
        percent = f"{100 * value:.2f}"
        lower, upper = (None if end is None else 100 * end for end in result.interval)
        return (
            name,
            percent if result.determined else Faint(percent),
            numbers.interval((lower, upper)),
            verdict,
        )

    verdict = f"{numbers.determined(load_scatter)}, shrinkage {100 * load_scatter.shrinkage:.0f} %"
    rows = [row("scatter between tests", load_scatter.scatter, load_scatter, verdict)]
    rows += [
        row(test.test, test.speed, test, "" if test.determined else numbers.determined(test))
        for test in load_scatter.tests
    ]
    header = ("test", "speed above the model's / %", "95 %", "verdict")
    return Table(
        f"{direction}: speed of each test above the model's, by a load that nobody measures",
        header,
        tuple(rows),
    )


def characteristic_tables(direction: str, characteristics: Characteristics) -> list[Table]:
    """Return the speed map of a direction, and its dead zone, delay and response time."""
    unit, load = characteristics.command_unit, characteristics.load
    rows = tuple(
        (
            numbers.digits(point.command),
            *([numbers.digits(point.load)] if load else []),
            numbers.quantity(point),
            numbers.interval(point.interval),
            numbers.determined(point),
        )
        for point in characteristics.speed_map
    )
    speed_header = f"speed / ({characteristics.speed_unit})"
    header = (f"command / {unit}", *([load] if load else []), speed_header, "95 %", "verdict")
    quantity_rows = tuple(
        (
            QUANTITY_TITLES[name],
            quantity_unit,
            numbers.quantity(quantity),
            numbers.interval(quantity.interval),
            numbers.determined(quantity),
        )
        for name, (quantity, quantity_unit) in characteristics.quantities.items()
    )
    step = f"step to {numbers.digits(characteristics.level)} {unit}"
    return [
        Table(f"{direction}: speed map, at mid stroke", header, rows),
        Table(
            f"{direction}: dead zone, delay, response time ({step})",
            ("quantity", "unit", "value", "95 %", "verdict"),
            quantity_rows,
        ),
    ]


# Table of searches compared with equal budgets.


def search_table(direction: str, searches: Sequence[SearchSummary], unit: str) -> Table:
    """Return the final errors of several searches, best first."""
    ends = {
        search.name: np.array([np.inf if end is None else end for end in search.rmse]) for search in searches
    }
    best = min(float(errors.min()) for errors in ends.values())
    medians = {name: float(np.median(errors)) for name, errors in ends.items()}
    # Of equal medians the search with the better worst seed is first.
    ordered = sorted(searches, key=lambda search: (medians[search.name], float(ends[search.name].max())))
    rows = tuple(
        (
            search.name,
            f"{medians[search.name]:.5g}",
            f"{ends[search.name].max():.5g}",
            numbers.percent(medians[search.name] / best - 1, 2),
            f"{np.sum(ends[search.name] <= 1.01 * best)} of {len(search.rmse)}",
            f"{np.mean(search.evaluations):.0f}",
            str(sum(search.failures)),
        )
        for search in ordered
    )
    header = (
        "search, best first",
        f"median RMSE / {unit}",
        f"worst seed / {unit}",
        "median above the best / %",
        "seeds within 1 % of the best",
        "evaluations",
        "failed",
    )
    return Table(f"{direction}: searches with equal evaluations, before least squares", header, rows)


# Tables of prediction bands and residual tests.


def band_table(direction: str, bands: BandFigures, unit: str) -> Table:
    """Return the share of unseen samples inside the bands, in free run and over horizons."""
    figures = [("free run", bands.covered, bands.width)]
    if bands.horizons is not None:
        ahead = [f"{numbers.count(step, 'sample')} ahead" for step in bands.horizons.steps]
        figures += zip(ahead, bands.horizons.covered, bands.horizons.width, strict=True)
    rows = tuple((name, numbers.percent(share), numbers.digits(width)) for name, share, width in figures)
    header = ("prediction", "covered / %", f"mean width / {unit}")
    level = numbers.percent(bands.coverage, 0)
    return Table(f"{direction}: band for {level} % of the samples of an unseen test", header, rows)


def residual_table(direction: str, residuals: Mapping[str, ResidualTests | None], unit: str) -> Table:
    """Return the tests of the errors, one step ahead and in free run."""
    header = (
        "errors",
        f"mean ± std / {unit}",
        "white",
        "independent of the command",
        "normal",
        "explained by position / %",
        "by speed / %",
        "by command / %",
        f"largest RMSE / {unit}",
    )
    rows = tuple((RUNS[run], *_residual_cells(tests, len(header) - 1)) for run, tests in residuals.items())
    return Table(f"{direction}: tests of the errors, level 1 %", header, rows)


def _residual_cells(tests: ResidualTests | None, count: int) -> tuple[str, ...]:
    if tests is None:
        return (numbers.DIVERGED, *[""] * (count - 1))
    quantity, worst = max(
        ((name, error_bin) for name, group in tests.by_quantity.items() for error_bin in group.bins),
        key=lambda pair: pair[1].rmse,
    )
    return (
        f"{tests.mean:.3g} ± {tests.deviation:.3g}",
        _decision(tests.white, tests.whiteness_p),
        _decision(tests.independent, tests.independence_p),
        _decision(tests.normal, tests.normality_p),
        *(numbers.percent(group.share, 0) for group in tests.by_quantity.values()),
        f"{quantity} {worst.lower:.3g} … {worst.upper:.3g}: {worst.rmse:.3g}",
    )


def _decision(passed: bool, probability: float) -> str:
    return f"{'yes' if passed else 'no'}, {numbers.p_value(probability)}"


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
    rows = []
    for name, figures in models:
        one_step, free_run = (
            ("",) * 6 if run is None else numbers.error_cells(run)
            for run in (figures.one_step, figures.free_run)
        )
        rmse, _, _, fit, largest, _ = free_run
        rows.append((name, one_step[0], rmse, fit, largest))
    return Table("", header, tuple(rows))


def _model_rows(accuracy: Accuracy) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (model_name(name), label, *numbers.error_cells(figures))
        for run, label in RUNS.items()
        for name in in_table_order(accuracy.models)
        if (figures := accuracy.models[name].run(run)) is not None
    )
