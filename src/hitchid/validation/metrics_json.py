"""Content of `metrics.json` and `comparison.json`, made from the records of a validation."""

from collections.abc import Mapping
from dataclasses import asdict

from hitchid.model import Characteristics, Estimate, Estimates, LoadScatter, Quantity, SearchSummary, TwoModes
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
    Horizons,
    ModelFigures,
    RunFigures,
)

JsonObject = dict[str, object]


def validation_json(
    unit: str, channels: Mapping[str, ChannelResult], cycles: CycleResult | None, mode_test: TwoModes | None
) -> JsonObject:
    """Return the content of `metrics.json`; errors in `unit`, parameters in the model's units."""
    content: JsonObject = {
        "unit": unit,
        "channels": {direction: _channel(result) for direction, result in channels.items()},
        CYCLES: {"tests": []} if cycles is None else _cycles(cycles),
    }
    return content if mode_test is None else {**content, "two_modes": asdict(mode_test)}


def _channel(result: ChannelResult) -> JsonObject:
    models = _models(result.accuracy)
    content = {
        **_accuracy(result.accuracy),
        BENCHMARK: models.pop(BENCHMARK),
        GREYBOX: models.pop(GREYBOX),
        "baselines": models,
        "residuals": {run: tests and asdict(tests) for run, tests in result.residuals.items()},
    }
    if result.parameters is not None:
        content["parameters"] = _estimates(result.parameters)
    if result.characteristics is not None:
        content["characteristics"] = _characteristics(result.characteristics)
    if result.load_scatter is not None:
        content["load_scatter"] = _load_scatter(result.load_scatter)
    if result.paper_parameters is not None:
        content["paper_parameters"] = _estimates(result.paper_parameters)
    if result.searches:
        content["searches"] = {search.name: _search(search) for search in result.searches}
    return content


def _cycles(result: CycleResult) -> JsonObject:
    return {**_accuracy(result.accuracy), **_models(result.accuracy), "max_jump": result.max_jump}


def _models(accuracy: Accuracy) -> JsonObject:
    return {name: _runs(figures) for name, figures in accuracy.models.items()}


def _runs(figures: ModelFigures) -> JsonObject:
    return {run: _run(run_figures) for run in RUNS if (run_figures := figures.run(run)) is not None}


def _run(figures: RunFigures) -> JsonObject:
    return asdict(figures)


def _accuracy(accuracy: Accuracy) -> JsonObject:
    """Return the content common to directions and cycles, without the figures of the models."""
    content: JsonObject = {
        "tests": list(accuracy.tests),
        "horizons": _horizons(accuracy.horizons),
        "per_test": {name: {FREE_RUN: _run(run)} for name, run in accuracy.per_test.items()},
    }
    return content if accuracy.bands is None else {**content, "bands": _bands(accuracy.bands)}


def _horizons(horizons: Horizons) -> JsonObject:
    return {"steps": list(horizons.steps), **{name: list(rmse) for name, rmse in horizons.rmse.items()}}


def _bands(bands: BandFigures) -> JsonObject:
    free_run = {"covered": bands.covered, "covered_error": bands.covered_error, "width": bands.width}
    content: JsonObject = {"coverage": bands.coverage, FREE_RUN: free_run}
    if bands.calibrated_on is not None:
        content["calibrated_on"] = dict(zip((FREE_RUN, "horizons"), bands.calibrated_on, strict=True))
    if bands.sensor_noise is not None:
        content["sensor_noise"] = bands.sensor_noise
    if bands.horizons is not None:
        content["horizons"] = {name: list(values) for name, values in asdict(bands.horizons).items()}
    return content


def _estimates(estimates: Estimates) -> JsonObject:
    return {
        "tests": estimates.tests,
        "independent": estimates.rows,
        "estimates": {estimate.name: _estimate(estimate) for estimate in estimates.parameters},
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


def _estimate(estimate: Estimate) -> JsonObject:
    return {
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


def _characteristics(characteristics: Characteristics) -> JsonObject:
    return {
        "command_unit": characteristics.command_unit,
        "speed_unit": characteristics.speed_unit,
        "load": characteristics.load,
        "dead_zone": _quantity(characteristics.dead_zone),
        "flow_begins": _quantity(characteristics.opening),
        "step_command": characteristics.level,
        "delay_s": _quantity(characteristics.delay),
        "response_time_s": _quantity(characteristics.response_time),
        "speed_map": [
            {
                "command": point.command,
                "load": point.load,
                "speed": point.speed,
                "lower": point.interval[0],
                "upper": point.interval[1],
                "determined": point.determined,
            }
            for point in characteristics.speed_map
        ],
        "measured_speeds": [asdict(measured) for measured in characteristics.measured],
    }


def _load_scatter(load_scatter: LoadScatter) -> JsonObject:
    return {
        "value": load_scatter.scatter,
        "interval_95": list(load_scatter.interval),
        "shrinkage": load_scatter.shrinkage,
        "determined": load_scatter.determined,
        "tests": {
            test.test: {"value": test.speed, "interval_95": list(test.interval)}
            for test in load_scatter.tests
        },
    }


def _quantity(quantity: Quantity | None) -> JsonObject | None:
    if quantity is None:
        return None
    lower, upper = quantity.interval
    return {"value": quantity.value, "lower": lower, "upper": upper, "determined": quantity.determined}


def _search(search: SearchSummary) -> JsonObject:
    return {
        "seeds": len(search.rmse),
        "rmse": list(search.rmse),
        "evaluations": list(search.evaluations),
        "failures": list(search.failures),
        "median_run": {
            "rmse": list(search.median_rmse),
            "values": [list(row) for row in search.median_values],
        },
    }
