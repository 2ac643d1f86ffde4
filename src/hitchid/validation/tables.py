"""Tables of a validation: what an error, an estimate, a band looks like, on every page and in every file."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from hitchid._support import numbers
from hitchid._support.tables import (
    Cell,
    Column,
    DataTable,
    RecordTable,
    Table,
    field_column,
    field_of,
    number_column,
)
from hitchid.model import SearchSummary
from hitchid.validation.estimate_tables import (
    characteristic_table,
    load_table,
    parameter_table,
    speed_map_table,
)
from hitchid.validation.report_data import HASH_DIGITS, LogUse
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import (
    CYCLES,
    RUNS,
    Accuracy,
    BandFigures,
    ChannelResult,
    CycleResult,
    ModelFigures,
    RunFigures,
    in_table_order,
    model_name,
)

Row = dict[str, Cell]


def validation_tables(
    unit: str,
    channels: Mapping[str, ChannelResult],
    cycles: CycleResult | None,
    model_units: Mapping[str, str],
) -> Iterator[DataTable]:
    """Yield the tables of each direction as data, then those of mixed cycles."""
    for direction, channel in channels.items():
        yield from _accuracy_data(direction, channel.accuracy, unit)
        for name, estimates in (
            ("parameters", channel.parameters),
            ("paper-parameters", channel.paper_parameters),
        ):
            if estimates is not None:
                yield parameter_table(direction, name, "", estimates).data()
        if channel.characteristics is not None:
            load_unit = model_units.get(channel.characteristics.load or "", "")
            yield speed_map_table(direction, channel.characteristics, load_unit=load_unit).data()
            yield characteristic_table(direction, channel.characteristics).data()
        if channel.load_scatter is not None:
            yield load_table(direction, channel.load_scatter).data()
        yield _residual_data(f"{direction}-residuals", channel.residuals, unit)
        yield _residual_bin_data(f"{direction}-residuals-by-quantity", channel.residuals, unit)
        if channel.searches:
            yield _search_data(f"{direction}-searches", channel.searches, unit)
    if cycles is not None:
        yield from _accuracy_data(CYCLES, cycles.accuracy, unit)


def _accuracy_data(section: str, accuracy: Accuracy, unit: str) -> Iterator[DataTable]:
    yield accuracy_table(section, accuracy, unit).data()
    horizons = accuracy.horizons
    models = {f"{model}_rmse_{unit}": horizons.rmse[model] for model in in_table_order(horizons.rmse)}
    yield DataTable.of_columns(f"{section}-horizons", {"horizon_samples": horizons.steps, **models})
    yield single_test_table(section, accuracy, unit).data()
    if accuracy.bands is not None:
        yield band_table(section, accuracy.bands, unit).data()


# Errors of a run.


def error_columns(unit: str) -> tuple[Column, ...]:
    """Return the columns of the errors of a run, which is the last item of each record.

    On pages every error has its significant digits. All follow from the standard error s of the RMSE r over
    tests: R² = 1 − (r/y)² has 2 (1 − R²) s/r and the fit 100 (1 − r/y) has (100 − fit) s/r; at most five
    decimals of R² and two of the fit.
    """

    def column(key: str, label: str, name: str, text: Callable[[Any], str]) -> Column:
        def shown(record: tuple) -> str:
            run = record[-1]
            return numbers.DIVERGED if None in (run.rmse, run.r2, run.fit, run.within_1) else text(run)

        return Column(key, label, lambda record: getattr(record[-1], name), shown)

    return (
        column(
            f"rmse_{unit}", f"RMSE / {unit}", "rmse", lambda run: numbers.with_error(run.rmse, run.rmse_error)
        ),
        Column(f"rmse_standard_error_{unit}", value=lambda record: record[-1].rmse_error),
        column(f"mae_{unit}", f"MAE / {unit}", "mae", lambda run: numbers.rounded(run.mae, run.rmse_error)),
        column("r2", "R²", "r2", _r2_text),
        column("fit_percent", "fit / %", "fit", _fit_text),
        column(
            f"max_abs_{unit}",
            f"max abs / {unit}",
            "max_abs",
            lambda run: numbers.rounded(run.max_abs, run.rmse_error),
        ),
        column(
            f"share_below_1_{unit}",
            f"below 1 {unit} / %",
            "within_1",
            lambda run: numbers.percent(run.within_1),
        ),
    )


def _r2_text(run: Any) -> str:
    if not run.rmse_error or not run.rmse:
        return f"{run.r2:.4f}"
    return numbers.rounded(run.r2, 2 * (1 - run.r2) * (run.rmse_error / run.rmse), 5)


def _fit_text(run: Any) -> str:
    if not run.rmse_error or not run.rmse:
        return f"{run.fit:.2f}"
    return numbers.rounded(run.fit, (100 - run.fit) * (run.rmse_error / run.rmse), 2)


def accuracy_table(section: str, accuracy: Accuracy, unit: str) -> RecordTable:
    """Return the errors of every model on the unseen tests, one step ahead and in free run."""
    tests = numbers.count(len(accuracy.tests), "unseen cycle" if section == CYCLES else "unseen test")
    names = (
        Column("model", "model", itemgetter(0), lambda record: model_name(record[0])),
        Column("run", "run", itemgetter(1), lambda record: RUNS[record[1]]),
    )
    records = tuple(
        (name, run, figures)
        for run in RUNS
        for name in in_table_order(accuracy.models)
        if (figures := accuracy.models[name].run(run)) is not None
    )
    title = f"{section}: accuracy {'over' if section == CYCLES else 'on'} {tests}"
    return RecordTable(f"{section}-accuracy", title, (*names, *error_columns(unit)), records)


def single_test_table(section: str, accuracy: Accuracy, unit: str) -> RecordTable:
    """Return the errors of the grey box in free run on every test."""
    columns = (Column("test", "test", itemgetter(0)), *error_columns(unit))
    title = f"{section}: grey box in free run, test by test"
    return RecordTable(f"{section}-tests", title, columns, tuple(accuracy.per_test.items()))


def summary_table(title: str, models: Iterable[tuple[str, ModelFigures]], unit: str) -> Table:
    """Return RMSE one step ahead and in free run, fit and largest error in free run, for a terminal."""
    columns = [column for column in error_columns(unit) if column.label]

    def texts(run: RunFigures | None) -> list[str]:
        return [column.shown((run,)) if run is not None else "" for column in columns]

    rows = []
    for name, figures in models:
        rmse, _, _, fit, largest, _ = texts(figures.free_run)
        rows.append((name, texts(figures.one_step)[0], rmse, fit, largest))
    header = (f"{title}, RMSE / {unit}", "one step", "free run", "fit / %", "largest")
    return Table("", header, tuple(rows))


def horizon_table(section: str, accuracy: Accuracy, unit: str) -> Table:
    """Return the RMSE of every model over each horizon."""
    horizons = accuracy.horizons
    rows = tuple(
        (model_name(name), *map(numbers.digits, horizons.rmse[name]))
        for name in in_table_order(horizons.rmse)
    )
    header = ("model", *map(str, horizons.steps))
    return Table(f"{section}: RMSE / {unit} over the horizon in samples", header, rows)


def band_table(section: str, bands: BandFigures, unit: str) -> RecordTable:
    """Return the share of unseen samples inside the bands: of the free run, then of each horizon."""
    columns = (
        Column("run", value=lambda record: "free_run" if record[0] is None else "horizon"),
        Column("horizon_samples", value=itemgetter(0)),
        Column(
            label="prediction",
            text=lambda record: (
                "free run" if record[0] is None else f"{numbers.count(record[0], 'sample')} ahead"
            ),
        ),
        Column("nominal_share", value=lambda record: bands.coverage),
        Column("covered_share", "covered / %", itemgetter(1), lambda record: numbers.percent(record[1])),
        number_column(f"mean_width_{unit}", f"mean width / {unit}", itemgetter(2)),
        Column("covered_standard_error", value=itemgetter(3)),
    )
    records = [(None, bands.covered, bands.width, bands.covered_error)]
    if bands.horizons is not None:
        ahead = zip(bands.horizons.steps, bands.horizons.covered, bands.horizons.width, strict=True)
        records += [(*horizon, None) for horizon in ahead]
    level = numbers.percent(bands.coverage, 0)
    title = f"{section}: band for {level} % of the samples of an unseen test"
    return RecordTable(f"{section}-bands", title, columns, tuple(records))


# Logs, tests of the errors, and searches compared with equal budgets.


def log_table(logs: Sequence[LogUse]) -> RecordTable:
    """Return the logs of a campaign and their use."""
    columns = (
        Column("log", "log", field_of("name")),
        field_column("kind"),
        field_column("used_as", "used as"),
        field_column("samples"),
        number_column("step_s", "step / s", field_of("step_s")),
        number_column("duration_s", "duration / s", field_of("duration_s")),
        Column("sha256_start", f"SHA-256, first {HASH_DIGITS}", field_of("digest")),
    )
    return RecordTable("logs", f"{len(logs)} logs", columns, tuple(logs))


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


def _residual_data(name: str, residuals: Mapping[str, ResidualTests | None], unit: str) -> DataTable:
    """Return the tests of the errors of each run; only the name of a run that diverged."""
    rows: list[Row] = []
    for run, tests in residuals.items():
        row: Row = {"run": run}
        if tests is not None:
            row |= {
                "errors": tests.count,
                f"mean_{unit}": tests.mean,
                f"standard_deviation_{unit}": tests.deviation,
                "white": tests.white,
                "whiteness_p": tests.whiteness_p,
                "independent_of_command": tests.independent,
                "independence_p": tests.independence_p,
                "normal": tests.normal,
                "normality_p": tests.normality_p,
                **{
                    f"share_explained_by_{quantity}": group.share
                    for quantity, group in tests.by_quantity.items()
                },
            }
        rows.append(row)
    return DataTable.of_rows(name, rows)


def _residual_bin_data(name: str, residuals: Mapping[str, ResidualTests | None], unit: str) -> DataTable:
    """Return the errors by displacement, speed and command; the ends of a bin are in its quantity's unit."""
    return DataTable.of_rows(
        name,
        (
            {
                "run": run,
                "quantity": quantity,
                "lower": error_bin.lower,
                "upper": error_bin.upper,
                "errors": error_bin.count,
                f"mean_{unit}": error_bin.mean,
                f"rmse_{unit}": error_bin.rmse,
            }
            for run, tests in residuals.items()
            if tests is not None
            for quantity, group in tests.by_quantity.items()
            for error_bin in group.bins
        ),
    )


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


def _search_data(name: str, searches: Sequence[SearchSummary], unit: str) -> DataTable:
    """Return the end of every run of every search; runs are numbered from 1."""
    return DataTable.of_rows(
        name,
        (
            {
                "search": search.name,
                "run": number,
                f"rmse_{unit}": rmse,
                "evaluations": evaluations,
                "failed_evaluations": failures,
            }
            for search in searches
            for number, (rmse, evaluations, failures) in enumerate(
                zip(search.rmse, search.evaluations, search.failures, strict=True), start=1
            )
        ),
    )
