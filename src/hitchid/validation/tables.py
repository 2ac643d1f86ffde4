"""Tables of a validation as data, from its records: one table for each file in `tables/`."""

from collections.abc import Iterator, Mapping, Sequence

from hitchid._support.tables import Cell, DataTable
from hitchid.model import Characteristics, Estimates, Interval, LoadScatter, SearchSummary
from hitchid.validation.report_data import LogUse
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import (
    CYCLES,
    RUNS,
    Accuracy,
    BandFigures,
    ChannelResult,
    CycleResult,
    RunFigures,
    in_table_order,
)

Row = dict[str, Cell]


def validation_tables(
    unit: str,
    channels: Mapping[str, ChannelResult],
    cycles: CycleResult | None,
    model_units: Mapping[str, str],
) -> Iterator[DataTable]:
    """Yield the tables of each direction, then those of mixed cycles.

    Args:
        unit: of the displacement in the logs.
        channels: direction to its results.
        cycles: results of the mixed cycles; None where there are none.
        model_units: signal to unit in the model.
    """
    for direction, channel in channels.items():
        yield from _accuracy_tables(direction, channel.accuracy, unit)
        for name, estimates in (
            ("parameters", channel.parameters),
            ("paper-parameters", channel.paper_parameters),
        ):
            if estimates is not None:
                yield _parameter_data(f"{direction}-{name}", estimates)
        if channel.characteristics is not None:
            yield _speed_map_data(f"{direction}-speed-map", channel.characteristics, model_units)
            yield _characteristic_data(f"{direction}-characteristics", channel.characteristics)
        if channel.load_scatter is not None:
            yield _load_scatter_data(f"{direction}-load-scatter", channel.load_scatter)
        yield _residual_data(f"{direction}-residuals", channel.residuals, unit)
        yield _residual_bin_data(f"{direction}-residuals-by-quantity", channel.residuals, unit)
        if channel.searches:
            yield _search_data(f"{direction}-searches", channel.searches, unit)
    if cycles is not None:
        yield from _accuracy_tables(CYCLES, cycles.accuracy, unit)


def log_table(logs: Sequence[LogUse]) -> DataTable:
    """Return the logs of a campaign and their use."""
    return DataTable.of_rows(
        "logs",
        (
            {
                "log": log.name,
                "kind": log.kind,
                "used_as": log.used_as,
                "samples": log.samples,
                "step_s": log.step_s,
                "duration_s": log.duration_s,
                "sha256_start": log.digest,
            }
            for log in logs
        ),
    )


def _accuracy_tables(section: str, accuracy: Accuracy, unit: str) -> Iterator[DataTable]:
    yield DataTable.of_rows(
        f"{section}-accuracy",
        (
            {"model": name, "run": run, **_error_cells(figures, unit)}
            for run in RUNS
            for name in in_table_order(accuracy.models)
            if (figures := accuracy.models[name].run(run)) is not None
        ),
    )
    yield _horizon_data(f"{section}-horizons", accuracy, unit)
    yield DataTable.of_rows(
        f"{section}-tests",
        ({"test": test, **_error_cells(figures, unit)} for test, figures in accuracy.per_test.items()),
    )
    if accuracy.bands is not None:
        yield _band_data(f"{section}-bands", accuracy.bands, unit)


def _error_cells(figures: RunFigures, unit: str) -> Row:
    return {
        f"rmse_{unit}": figures.rmse,
        f"rmse_standard_error_{unit}": figures.rmse_error,
        f"mae_{unit}": figures.mae,
        "r2": figures.r2,
        "fit_percent": figures.fit,
        f"max_abs_{unit}": figures.max_abs,
        f"share_below_1_{unit}": figures.within_1,
    }


def _horizon_data(name: str, accuracy: Accuracy, unit: str) -> DataTable:
    """Return the RMSE of every model, one row for each horizon."""
    horizons = accuracy.horizons
    models = {f"{model}_rmse_{unit}": horizons.rmse[model] for model in in_table_order(horizons.rmse)}
    return DataTable.of_columns(name, {"horizon_samples": horizons.steps, **models})


def _band_data(name: str, bands: BandFigures, unit: str) -> DataTable:
    """Return the share of unseen samples inside the bands: of the free run, then of each horizon."""
    rows: list[Row] = [_band_row("free_run", None, bands.coverage, bands.covered, bands.width, unit)]
    rows[0]["covered_standard_error"] = bands.covered_error
    if bands.horizons is not None:
        ahead = zip(bands.horizons.steps, bands.horizons.covered, bands.horizons.width, strict=True)
        rows += [
            _band_row("horizon", step, bands.coverage, covered, width, unit) for step, covered, width in ahead
        ]
    return DataTable.of_rows(name, rows)


def _band_row(run: str, step: int | None, nominal: float, covered: float, width: float, unit: str) -> Row:
    return {
        "run": run,
        "horizon_samples": step,
        "nominal_share": nominal,
        "covered_share": covered,
        f"mean_width_{unit}": width,
    }


def _interval(interval: Interval | None, prefix: str, suffix: str = "") -> Row:
    lower, upper = interval or (None, None)
    return {f"{prefix}_lower{suffix}": lower, f"{prefix}_upper{suffix}": upper}


def _parameter_data(name: str, estimates: Estimates) -> DataTable:
    """Return parameters, then quantities derived from them; the unit of each row is in a column."""
    parameters: list[Row] = [
        {
            "name": estimate.name,
            "symbol": estimate.symbol,
            "unit": estimate.unit,
            "value": estimate.value,
            "standard_error": estimate.error,
            **_interval(estimate.interval, "interval_95"),
            "method": estimate.method,
            **_interval(estimate.bootstrap, "bootstrap_95"),
            "bound_lower": estimate.lower,
            "bound_upper": estimate.upper,
            "rmse_change_for_1_percent": estimate.sensitivity,
            "determined": estimate.determined,
            "verdict": estimate.verdict,
        }
        for estimate in estimates.parameters
    ]
    derived: list[Row] = [
        {
            "name": quantity.name,
            "unit": quantity.unit,
            "value": quantity.value,
            **_interval(quantity.interval, "interval_95"),
            "determined": quantity.determined,
        }
        for quantity in estimates.derived
    ]
    return DataTable.of_rows(name, [*parameters, *derived])


def _speed_map_data(name: str, characteristics: Characteristics, model_units: Mapping[str, str]) -> DataTable:
    """Return the speed map, then the measured speeds of the identification tests."""
    command, speed = f"command_{characteristics.command_unit}", f"speed_{characteristics.speed_unit}"
    load = characteristics.load and f"{characteristics.load}_{model_units[characteristics.load]}"

    def cells(level: float, value: float, load_value: float | None) -> Row:
        return {command: level, **({load: load_value} if load else {}), speed: value}

    modelled: list[Row] = [
        {
            "origin": "model",
            **cells(point.command, point.speed, point.load),
            **_interval(point.interval, "interval_95", f"_{characteristics.speed_unit}"),
            "determined": point.determined,
        }
        for point in characteristics.speed_map
    ]
    measured: list[Row] = [
        {"origin": "measured", **cells(point.command, point.speed, point.load)}
        for point in characteristics.measured
    ]
    return DataTable.of_rows(name, [*modelled, *measured])


def _characteristic_data(name: str, characteristics: Characteristics) -> DataTable:
    quantities = {
        "dead_zone": (characteristics.dead_zone, characteristics.command_unit),
        "flow_begins": (characteristics.opening, characteristics.command_unit),
        "delay": (characteristics.delay, "s"),
        "response_time": (characteristics.response_time, "s"),
    }
    return DataTable.of_rows(
        name,
        (
            {
                "quantity": quantity_name,
                "unit": unit,
                "value": quantity.value,
                **_interval(quantity.interval, "interval_95"),
                "determined": quantity.determined,
                f"step_to_{characteristics.command_unit}": characteristics.level,
            }
            for quantity_name, (quantity, unit) in quantities.items()
            if quantity is not None
        ),
    )


def _load_scatter_data(name: str, load_scatter: LoadScatter) -> DataTable:
    """Return the scatter of the speed between tests, then each test's own speed, all relative."""
    scatter: Row = {
        "test": "scatter",
        "speed": load_scatter.scatter,
        **_interval(load_scatter.interval, "interval_95"),
        "shrinkage": load_scatter.shrinkage,
        "determined": load_scatter.determined,
    }
    tests: list[Row] = [
        {"test": test.test, "speed": test.speed, **_interval(test.interval, "interval_95")}
        for test in load_scatter.tests
    ]
    return DataTable.of_rows(name, [scatter, *tests])


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
