"""Content of `metrics.json`, and a table for each file in `tables/`, from the records of a validation."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from hitchid._support.tables import Cell, DataTable
from hitchid.model import Characteristics, Estimates, Interval, LoadScatter, Quantity, SearchSummary, TwoModes
from hitchid.validation.report_data import LogUse
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import (
    BENCHMARK,
    CYCLES,
    FREE_RUN,
    GREYBOX,
    RUNS,
    Accuracy,
    BandFigures,
    ChannelResult,
    CycleResult,
    RunFigures,
    in_table_order,
)

JsonObject = dict[str, Any]
Row = dict[str, Cell]

# Content of `metrics.json`.


def validation_json(
    unit: str, channels: Mapping[str, ChannelResult], cycles: CycleResult | None, mode_test: TwoModes | None
) -> JsonObject:
    """Return the content of `metrics.json`; errors in `unit`, parameters in the model's units."""
    content: JsonObject = {
        "unit": unit,
        "channels": {direction: _channel(result) for direction, result in channels.items()},
        CYCLES: {"tests": []},
    }
    if cycles is not None:
        accuracy = cycles.accuracy
        content[CYCLES] = {**_accuracy(accuracy), **_models(accuracy), "max_jump": cycles.max_jump}
    return content if mode_test is None else {**content, "two_modes": asdict(mode_test)}


def _channel(result: ChannelResult) -> JsonObject:
    models = _models(result.accuracy)
    scatter = result.load_scatter
    content = {
        **_accuracy(result.accuracy),
        BENCHMARK: models.pop(BENCHMARK),
        GREYBOX: models.pop(GREYBOX),
        "baselines": models,
        "residuals": {run: tests and asdict(tests) for run, tests in result.residuals.items()},
        "parameters": result.parameters and _estimates(result.parameters),
        "characteristics": result.characteristics and _characteristics(result.characteristics),
        "load_scatter": scatter
        and {
            "value": scatter.scatter,
            "interval_95": list(scatter.interval),
            "shrinkage": scatter.shrinkage,
            "determined": scatter.determined,
            "tests": {
                test.test: {"value": test.speed, "interval_95": list(test.interval)} for test in scatter.tests
            },
        },
        "paper_parameters": result.paper_parameters and _estimates(result.paper_parameters),
        "searches": {
            search.name: {
                "seeds": len(search.rmse),
                "rmse": list(search.rmse),
                "evaluations": list(search.evaluations),
                "failures": list(search.failures),
                "median_run": {
                    "rmse": list(search.median_rmse),
                    "values": [list(row) for row in search.median_values],
                },
            }
            for search in result.searches
        }
        or None,
    }
    return {name: value for name, value in content.items() if value is not None}


def _models(accuracy: Accuracy) -> JsonObject:
    return {
        name: {run: asdict(figures) for run in RUNS if (figures := models.run(run)) is not None}
        for name, models in accuracy.models.items()
    }


def _accuracy(accuracy: Accuracy) -> JsonObject:
    """Return the content common to directions and cycles, without the figures of the models."""
    horizons, bands = accuracy.horizons, accuracy.bands
    content: JsonObject = {
        "tests": list(accuracy.tests),
        "horizons": {
            "steps": list(horizons.steps),
            **{name: list(rmse) for name, rmse in horizons.rmse.items()},
        },
        "per_test": {name: {FREE_RUN: asdict(run)} for name, run in accuracy.per_test.items()},
    }
    if bands is not None:
        free_run = {"covered": bands.covered, "covered_error": bands.covered_error, "width": bands.width}
        content["bands"] = {"coverage": bands.coverage, FREE_RUN: free_run}
        if bands.calibrated_on is not None:
            of_horizons = dict(zip((FREE_RUN, "horizons"), bands.calibrated_on, strict=True))
            content["bands"]["calibrated_on"] = of_horizons
        if bands.sensor_noise is not None:
            content["bands"]["sensor_noise"] = bands.sensor_noise
        if bands.horizons is not None:
            ahead = {name: list(values) for name, values in asdict(bands.horizons).items()}
            content["bands"]["horizons"] = ahead
    return content


def _estimates(estimates: Estimates) -> JsonObject:
    return {
        "tests": estimates.tests,
        "independent": estimates.rows,
        "estimates": {
            estimate.name: {
                "symbol": estimate.symbol,
                "unit": estimate.unit,
                "value": estimate.value,
                "standard_error": estimate.error,
                "interval_95": list(estimate.interval),
                "method": estimate.method,
                "bootstrap_95": estimate.bootstrap and list(estimate.bootstrap),
                "determined": estimate.determined,
                "verdict": estimate.verdict,
                "sensitivity": estimate.sensitivity,
                "bounds": [estimate.lower, estimate.upper],
                "profile": [list(point) for point in estimate.profile],
            }
            for estimate in estimates.parameters
        },
        "derived": {
            quantity.name: {
                "unit": quantity.unit,
                "value": quantity.value,
                "interval_95": list(quantity.interval),
                "determined": quantity.determined,
            }
            for quantity in estimates.derived
        },
        "correlation": [list(row) for row in estimates.correlation],
    }


def _characteristics(characteristics: Characteristics) -> JsonObject:
    def quantity(result: Quantity | None) -> JsonObject | None:
        return result and {"value": result.value, **_ends(result.interval), "determined": result.determined}

    return {
        "command_unit": characteristics.command_unit,
        "speed_unit": characteristics.speed_unit,
        "load": characteristics.load,
        "dead_zone": quantity(characteristics.dead_zone),
        "flow_begins": quantity(characteristics.opening),
        "step_command": characteristics.level,
        "delay_s": quantity(characteristics.delay),
        "response_time_s": quantity(characteristics.response_time),
        "speed_map": [
            {
                "command": point.command,
                "load": point.load,
                "speed": point.speed,
                **_ends(point.interval),
                "determined": point.determined,
            }
            for point in characteristics.speed_map
        ],
        "measured_speeds": [asdict(measured) for measured in characteristics.measured],
    }


def _ends(interval: Interval | None, prefix: str = "", suffix: str = "") -> Row:
    lower, upper = interval or (None, None)
    return {f"{prefix}lower{suffix}": lower, f"{prefix}upper{suffix}": upper}


# Tables with numbers at full precision.


def validation_tables(
    unit: str,
    channels: Mapping[str, ChannelResult],
    cycles: CycleResult | None,
    model_units: Mapping[str, str],
) -> Iterator[DataTable]:
    """Yield the tables of each direction, then those of mixed cycles."""
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
    horizons = accuracy.horizons
    models = {f"{model}_rmse_{unit}": horizons.rmse[model] for model in in_table_order(horizons.rmse)}
    yield DataTable.of_columns(f"{section}-horizons", {"horizon_samples": horizons.steps, **models})
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


def _band_data(name: str, bands: BandFigures, unit: str) -> DataTable:
    """Return the share of unseen samples inside the bands: of the free run, then of each horizon."""

    def row(run: str, step: int | None, covered: float, width: float) -> Row:
        shares: Row = {"nominal_share": bands.coverage, "covered_share": covered}
        return {"run": run, "horizon_samples": step, **shares, f"mean_width_{unit}": width}

    free_run = row("free_run", None, bands.covered, bands.width)
    rows = [free_run | {"covered_standard_error": bands.covered_error}]
    if bands.horizons is not None:
        ahead = zip(bands.horizons.steps, bands.horizons.covered, bands.horizons.width, strict=True)
        rows += [row("horizon", step, covered, width) for step, covered, width in ahead]
    return DataTable.of_rows(name, rows)


def _parameter_data(name: str, estimates: Estimates) -> DataTable:
    """Return parameters, then quantities derived from them; the unit of each row is in a column."""
    parameters: list[Row] = [
        {
            "name": estimate.name,
            "symbol": estimate.symbol,
            "unit": estimate.unit,
            "value": estimate.value,
            "standard_error": estimate.error,
            **_ends(estimate.interval, "interval_95_"),
            "method": estimate.method,
            **_ends(estimate.bootstrap, "bootstrap_95_"),
            "bound_lower": estimate.lower,
            "bound_upper": estimate.upper,
            "rmse_change_for_1_percent": estimate.sensitivity,
            "determined": estimate.determined,
            "verdict": estimate.verdict,
        }
        for estimate in estimates.parameters
    ]
    derived: list[Row] = [
        {"name": quantity.name, "unit": quantity.unit, **_quantity_cells(quantity)}
        for quantity in estimates.derived
    ]
    return DataTable.of_rows(name, [*parameters, *derived])


def _quantity_cells(quantity: Quantity) -> Row:
    ends = _ends(quantity.interval, "interval_95_")
    return {"value": quantity.value, **ends, "determined": quantity.determined}


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
            **_ends(point.interval, "interval_95_", f"_{characteristics.speed_unit}"),
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
    return DataTable.of_rows(
        name,
        (
            {
                "quantity": quantity_name,
                "unit": unit,
                **_quantity_cells(quantity),
                f"step_to_{characteristics.command_unit}": characteristics.level,
            }
            for quantity_name, (quantity, unit) in characteristics.quantities.items()
        ),
    )


def _load_scatter_data(name: str, load_scatter: LoadScatter) -> DataTable:
    """Return the scatter of the speed between tests, then each test's own speed, all relative."""
    scatter: Row = {
        "test": "scatter",
        "speed": load_scatter.scatter,
        **_ends(load_scatter.interval, "interval_95_"),
        "shrinkage": load_scatter.shrinkage,
        "determined": load_scatter.determined,
    }
    tests: list[Row] = [
        {"test": test.test, "speed": test.speed, **_ends(test.interval, "interval_95_")}
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
