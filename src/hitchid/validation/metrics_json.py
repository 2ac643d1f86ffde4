"""Content of `metrics.json`, from the records of a validation."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from hitchid.model import Characteristics, Estimates, Interval, Quantity, TwoModes
from hitchid.validation.results import (
    BENCHMARK,
    CYCLES,
    FREE_RUN,
    GREYBOX,
    RUNS,
    Accuracy,
    ChannelResult,
    CycleResult,
)

JsonObject = dict[str, Any]


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


def _ends(interval: Interval) -> JsonObject:
    lower, upper = interval
    return {"lower": lower, "upper": upper}
