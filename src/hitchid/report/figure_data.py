"""Data behind the figures of a report: one function for each kind of figure, column name to values.

Units are in the names of the columns; columns may differ in length.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from hitchid.logs.kinds import Segment
from hitchid.logs.record import COMMAND, DISPLACEMENT, Record
from hitchid.model import Characteristics, Estimate, LoadScatter, SearchSummary
from hitchid.model.trace import TracedCandidate, TracedSearch, TracedTraining
from hitchid.validation import BandFigures, Horizons, Predictions
from hitchid.validation.residuals import ResidualTests
from hitchid.validation.results import concatenate_tests
from hitchid.validation.valve_map import ValveMap

Columns = Mapping[str, Sequence | np.ndarray]


def outputs(tests: Predictions, unit: str, models: Sequence[str]) -> Columns:
    """Return time, measured and predicted displacement and the band, test below test."""
    columns: dict[str, Sequence | np.ndarray] = {
        "test": _test_names(tests),
        "time_s": np.concatenate(tests.time_s),
        f"measured_{unit}": np.concatenate(tests.actual),
        **{f"{model}_{unit}": np.concatenate(tests.models[model]) for model in models},
    }
    if tests.band is not None:
        lower, upper = map(np.concatenate, tests.band)
        columns |= {f"free_run_band_lower_{unit}": lower, f"free_run_band_upper_{unit}": upper}
    return columns


def errors(rows: Mapping[str, np.ndarray], unit: str) -> Columns:
    """Return the errors of each model or subset of the data."""
    return {f"{name}_error_{unit}": values for name, values in rows.items()}


def errors_by_test(tests: Predictions, unit: str, models: Sequence[str]) -> Columns:
    """Return the RMSE of each test in free run; infinite where a model diverged."""
    return {"test": tests.names, **{f"{model}_rmse_{unit}": tests.rmse(model) for model in models}}


def horizons(result: Horizons, step_s: float, unit: str) -> Columns:
    """Return the RMSE of each model over the horizon."""
    return {
        "horizon_samples": result.steps,
        "horizon_s": step_s * np.array(result.steps),
        **{f"{model}_rmse_{unit}": values for model, values in result.rmse.items()},
    }


def predicted_errors(subsets: Mapping[str, Predictions], unit: str, samples: int) -> Columns:
    """Return the benchmark's error and its prediction one step ahead, the first samples of each subset."""
    columns = {}
    for subset, tests in subsets.items():
        measured, benchmark, one_step = (
            concatenate_tests(rows)[:samples]
            for rows in (tests.actual, tests.models["benchmark"], tests.models["one_step"])
        )
        columns[f"{subset}_actual_{unit}"] = measured - benchmark
        columns[f"{subset}_predicted_{unit}"] = one_step - benchmark
    return columns


def coverage(bands: BandFigures, step_s: float) -> Columns:
    """Return the share of samples inside the bands of the free run and of each horizon."""
    columns: dict[str, Sequence | np.ndarray] = {
        "nominal_share": (bands.coverage,),
        "free_run_covered_share": (bands.covered,),
    }
    if bands.horizons is None:
        return columns
    ahead_s = step_s * np.array(bands.horizons.steps)
    return {"horizon_s": ahead_s, "horizon_covered_share": bands.horizons.covered, **columns}


def residual_correlations(tests: ResidualTests) -> Columns:
    """Return autocorrelation of the errors, and their correlation with the command, with 99 % bounds."""
    return {
        "lag_s": tests.step_s * np.arange(1, len(tests.autocorrelation) + 1),
        "autocorrelation": tests.autocorrelation,
        "autocorrelation_bound": tests.autocorrelation_bounds,
        "command_lag_s": tests.step_s * np.array(tests.cross_lags),
        "command_correlation": tests.cross_correlation,
        "command_correlation_bound": tests.cross_bounds,
    }


def residuals_by_variable(tests: ResidualTests, unit: str, command_unit: str) -> Columns:
    """Return mean and RMSE of the errors in bins of displacement, speed and command."""
    units = {"position": unit, "speed": f"{unit}/s", "command": command_unit}
    columns = {}
    for quantity, group in tests.by_quantity.items():
        columns |= {
            f"{quantity}_lower_{units[quantity]}": [interval.lower for interval in group.bins],
            f"{quantity}_upper_{units[quantity]}": [interval.upper for interval in group.bins],
            f"{quantity}_mean_error_{unit}": [interval.mean for interval in group.bins],
            f"{quantity}_rmse_{unit}": [interval.rmse for interval in group.bins],
        }
    return columns


def speed_map(characteristics: Characteristics) -> Columns:
    """Return speed over command with its 95 % band, and the measured speeds."""
    points, measured = characteristics.speed_map, characteristics.measured
    command, speed = characteristics.command_unit, characteristics.speed_unit
    load = characteristics.load
    return {
        f"command_{command}": [point.command for point in points],
        **({load: [point.load for point in points]} if load else {}),
        f"speed_{speed}": [point.speed for point in points],
        f"speed_lower_{speed}": [point.interval[0] for point in points],
        f"speed_upper_{speed}": [point.interval[1] for point in points],
        f"measured_command_{command}": [point.command for point in measured],
        **({f"measured_{load}": [point.load for point in measured]} if load else {}),
        f"measured_speed_{speed}": [point.speed for point in measured],
    }


def valve_map(valve: ValveMap, unit: str, command_unit: str) -> Columns:
    """Return speed over command: of the benchmark, quantiles of the tests, and each slow ramp."""
    columns = {
        f"benchmark_command_{command_unit}": valve.commands,
        f"benchmark_speed_{unit}/s": valve.speeds,
        f"tests_command_{command_unit}": [speeds.command for speeds in valve.bins],
        f"tests_speed_10_percent_{unit}/s": [speeds.low for speeds in valve.bins],
        f"tests_speed_median_{unit}/s": [speeds.middle for speeds in valve.bins],
        f"tests_speed_90_percent_{unit}/s": [speeds.high for speeds in valve.bins],
        f"dead_zone_{command_unit}": valve.dead_zones,
    }
    for number, (command, speed) in enumerate(valve.ramps, start=1):
        columns |= {f"ramp_{number}_command_{command_unit}": command, f"ramp_{number}_speed_{unit}/s": speed}
    return columns


def intervals(estimates: Sequence[Estimate]) -> Columns:
    """Return each parameter with its 95 % interval and that of the bootstrap."""
    return {
        "name": [estimate.name for estimate in estimates],
        "unit": [estimate.unit for estimate in estimates],
        "value": [estimate.value for estimate in estimates],
        "interval_95_lower": [estimate.interval[0] for estimate in estimates],
        "interval_95_upper": [estimate.interval[1] for estimate in estimates],
        "bootstrap_95_lower": [estimate.bootstrap and estimate.bootstrap[0] for estimate in estimates],
        "bootstrap_95_upper": [estimate.bootstrap and estimate.bootstrap[1] for estimate in estimates],
    }


def loads(load_scatter: LoadScatter) -> Columns:
    """Return the speed of each test above the model's with its 95 % interval, and the scatter, in percent."""
    return {
        "test": [test.test for test in load_scatter.tests],
        "speed_percent": [100 * test.speed for test in load_scatter.tests],
        "interval_95_lower_percent": [100 * test.interval[0] for test in load_scatter.tests],
        "interval_95_upper_percent": [100 * test.interval[1] for test in load_scatter.tests],
        "scatter_percent": (100 * load_scatter.scatter,),
    }


def dead_zone(
    ramps: Sequence[Record], direction: str, value: float, spread: float | None, unit: str, command_unit: str
) -> Columns:
    """Return command and displacement of each slow ramp, and the dead zone with its standard deviation."""
    columns: dict[str, Sequence | np.ndarray] = {
        f"dead_zone_{command_unit}": (value,),
        f"dead_zone_standard_deviation_{command_unit}": (spread,),
    }
    for number, ramp in enumerate(ramps, start=1):
        columns |= {
            f"ramp_{number}_command_{command_unit}": ramp.command(direction),
            f"ramp_{number}_displacement_{unit}": ramp.displacement,
        }
    return columns


def convergence(search: TracedSearch, unit: str) -> Columns:
    """Return best RMSE and each parameter over the iterations of the search."""
    names = [parameter.name for parameter in search.parameters]
    return {
        "iteration": np.arange(1, len(search.fitness) + 1),
        f"rmse_{unit}": search.fitness,
        **dict(zip(names, np.array(search.values).T, strict=True)),
    }


def losses(training: TracedTraining) -> Columns:
    """Return the losses of the compensator's training over the epochs."""
    return {
        "epoch": np.arange(1, max(len(training.training_loss), len(training.validation_loss)) + 1),
        "training_loss": training.training_loss,
        "validation_loss": training.validation_loss,
    }


def structures(candidates: Sequence[TracedCandidate], unit: str) -> Columns:
    """Return the compared model specifications with their RMSE."""
    return {
        "structure": [candidate.name for candidate in candidates],
        f"rmse_{unit}": [candidate.rmse for candidate in candidates],
        f"held_out_rmse_{unit}": [candidate.held_out_rmse for candidate in candidates],
        f"held_out_rmse_per_test_gain_{unit}": [
            candidate.held_out_rmse_per_test_gain for candidate in candidates
        ],
        "chosen": [candidate.chosen for candidate in candidates],
    }


def searches(results: Sequence[SearchSummary], unit: str) -> Columns:
    """Return the best RMSE of each search over its budget, and the final RMSE of its runs."""
    columns = {}
    for result in results:
        columns |= {
            f"{result.name}_budget_percent": np.linspace(0, 100, len(result.median_rmse)),
            f"{result.name}_median_run_rmse_{unit}": result.median_rmse,
            f"{result.name}_final_rmse_{unit}": result.rmse,
        }
    return columns


def timeline(records: Sequence[tuple[Record, Sequence[Segment]]]) -> Columns:
    """Return displacement, commands and segment of each sample, log below log."""
    roles = [DISPLACEMENT, *COMMAND.values()]
    columns: dict[str, list] = {"log": [], "time_s": [], "segment": []}
    for record, segments in records:
        columns["log"] += [record.name] * len(record)
        columns["time_s"] += (record.start_s + record.step_s * np.arange(len(record))).tolist()
        for label, start, stop in segments:
            columns["segment"] += [label] * (stop - start)
        for role in roles:
            if role in record.signals:
                columns.setdefault(f"{role}_{record.units[role]}", []).extend(record.signals[role].tolist())
    return columns


def _test_names(tests: Predictions) -> list[str]:
    return [name for name, time_s in zip(tests.names, tests.time_s, strict=True) for _ in time_s]
