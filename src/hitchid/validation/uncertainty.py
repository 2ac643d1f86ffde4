"""How far a model can be trusted, as figures: parameters, residuals, bands, searches."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from hitchid.estimation import Trail
from hitchid.model import Band, Channel
from hitchid.model.possible import spread
from hitchid.structures import Batch
from hitchid.uncertainty import Bands, Characteristics, Estimates, Quantity, Uncertainty
from hitchid.validation.residuals import residual_tests

COVERAGE = 0.9


def trust_figures(known: Uncertainty, factor: float = 1.0) -> dict:
    """Return what identification found of parameters and searches, as JSON can hold it.

    Args:
        known: how far a channel can be trusted.
        factor: from the model's unit of displacement to that of the figures, for errors; parameters stay in
            the model's units, which are told with them.
    """
    found = {"parameters": parameter_figures(known.benchmark, factor)}
    if known.characteristics is not None:
        found["characteristics"] = characteristic_figures(known.characteristics)
    if known.paper is not None:
        found["paper_parameters"] = parameter_figures(known.paper, factor)
    if known.searches:
        found["searches"] = {trail.name: _search(trail, factor) for trail in known.searches}
    return found


def parameter_figures(known: Estimates, factor: float = 1.0) -> dict:
    """Return estimates, what follows from them, and their correlation, as JSON can hold them.

    Args:
        known: the estimates.
        factor: as for `trust_figures`.
    """
    return {
        "tests": known.tests,
        "independent": known.rows,
        "estimates": {
            each.name: {
                "symbol": each.symbol,
                "unit": each.unit,
                "value": each.value,
                "standard_error": each.error,
                "interval_95": list(each.interval),
                "method": each.method,
                "bootstrap_95": None if each.bootstrap is None else list(each.bootstrap),
                "determined": each.determined,
                "verdict": each.verdict,
                "sensitivity": each.sensitivity,
                "bounds": [each.lower, each.upper],
                "profile": [[value, factor * rmse] for value, rmse in each.profile],
            }
            for each in known.parameters
        },
        "derived": {
            each.name: {
                "unit": each.unit,
                "value": each.value,
                "interval_95": list(each.interval),
                "determined": each.determined,
            }
            for each in known.derived
        },
        "correlation": [list(row) for row in known.correlation],
    }


def characteristic_figures(known: Characteristics) -> dict:
    """Return speed map, dead zone, delay and response time, as JSON can hold them, in the model's units."""
    return {
        "command_unit": known.command_unit,
        "speed_unit": known.speed_unit,
        "load": known.load,
        "dead_zone": _quantity(known.dead_zone),
        "flow_begins": _quantity(known.opening),
        "step_command": known.level,
        "delay_s": _quantity(known.delay),
        "response_time_s": _quantity(known.response_time),
        "speed_map": [
            {
                "command": point.command,
                "load": point.load,
                "speed": point.speed,
                "lower": point.interval[0],
                "upper": point.interval[1],
                "determined": point.determined,
            }
            for point in known.speed_map
        ],
        "measured_speeds": [asdict(each) for each in known.measured],
    }


def _quantity(known: Quantity | None) -> dict | None:
    if known is None:
        return None
    lower, upper = known.interval
    return {"value": known.value, "lower": lower, "upper": upper, "determined": known.determined}


def _search(trail: Trail, factor: float) -> dict:
    """Return how one search went from its seeds: ends, effort, and the run in the middle, step by step."""
    middle = trail.runs[int(np.argsort(trail.ends)[len(trail.runs) // 2])]
    return {
        "seeds": len(trail.runs),
        "rmse": [_times(run.last, factor) for run in trail.runs],
        "evaluations": [run.evaluations for run in trail.runs],
        "failures": [run.failures for run in trail.runs],
        "median_run": {
            "rmse": [_times(each, factor) for each in middle.fitness],
            "values": [list(row) for row in middle.values],
        },
    }


def _times(error: float | None, factor: float) -> float | None:
    return None if error is None else factor * error


def residual_figures(channel: Channel, batch: Batch, predicted: np.ndarray, factor: float) -> dict | None:
    """Test the errors of predictions for what a model ought to have explained.

    Args:
        channel: of the model.
        batch: tests.
        predicted: displacement, shape [T, N].
        factor: from the model's unit of displacement to that of the figures.

    Returns:
        The findings as JSON can hold them; None where the predictions diverged.
    """
    counted = np.asarray(batch.counted)
    simulated = np.asarray(channel.simulate(batch))
    with np.errstate(over="ignore", invalid="ignore"):
        diverged = not all(np.isfinite(np.sum(rows[counted] ** 2)) for rows in (predicted, simulated))
    if diverged:
        return None
    speed = np.gradient(simulated, batch.step_s, axis=1)

    def rows(values: np.ndarray) -> list[np.ndarray]:
        return [row[here] for row, here in zip(np.asarray(values), counted, strict=True)]

    found = residual_tests(
        rows(factor * (np.asarray(batch.displacement) - predicted)),
        rows(np.asarray(batch.command)),
        rows(factor * simulated),
        rows(factor * speed),
        step_s=batch.step_s,
    )
    return asdict(found)


def free_run_band(channel: Channel, bands: Bands, batch: Batch) -> np.ndarray:
    """Return the half width of the band around the free run, in the model's unit, shape [T, N].

    Args:
        channel, bands: of the model.
        batch: tests.
    """
    _, apart = spread(channel, bands.alternatives, batch)
    return bands.free_run_half_width(COVERAGE, np.sqrt(np.sum(apart**2, axis=0)))


def band_figures(
    bands: Bands,
    batch: Batch,
    simulated: np.ndarray,
    half: np.ndarray,
    ahead: np.ndarray,
    steps: Sequence[int],
    factor: float,
) -> dict:
    """Return what share of unseen samples bands cover, each test weighing the same, and how wide they are.

    Args:
        bands: of the channel.
        batch: tests.
        simulated, half: the free run and the half width of its band, shape [T, N].
        ahead: predictions over horizons, shape [H, T, N].
        steps: the horizons.
        factor: from the model's unit of displacement to that of the figures.
    """
    counted, measured = np.asarray(batch.counted), np.asarray(batch.displacement)
    late = [counted & (np.arange(counted.shape[1]) >= step) for step in steps]
    widths = [bands.half_width(COVERAGE, step) for step in steps]
    return {
        "coverage": COVERAGE,
        "calibrated_on": {"free_run": bands.tests[0], "horizons": bands.tests[1]},
        "sensor_noise": factor * bands.noise,
        "free_run": {
            **_held(_shares(np.abs(measured - simulated) <= half, counted)),
            "width": factor * float(np.mean(2 * half[counted])),
        },
        "horizons": {
            "steps": list(steps),
            "covered": [
                float(np.mean(_shares(np.abs(measured - rows) <= width, here)))
                for rows, width, here in zip(ahead, widths, late, strict=True)
            ],
            "width": [2 * factor * width for width in widths],
        },
    }


def cycle_band_figures(bands: Sequence[Band], actual: Sequence[np.ndarray]) -> dict:
    """Return what share of unseen cycles bands around the free run cover, and how wide they are.

    Args:
        bands: around the free run of each cycle.
        actual: measured displacement, of the same shapes.
    """
    pairs = list(zip(bands, actual, strict=True))
    shares = [np.mean((lower <= y) & (y <= upper)) for (lower, upper), y in pairs]
    widths = [np.mean(upper - lower) for lower, upper in bands]
    found = {**_held(np.array(shares)), "width": float(np.mean(widths))}
    return {"coverage": COVERAGE, "free_run": found}


def _shares(inside: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return the share of samples inside, of each test that has any."""
    counts = counted.sum(axis=1)
    return (inside & counted).sum(axis=1)[counts > 0] / counts[counts > 0]


def _held(shares: np.ndarray) -> dict[str, float | None]:
    """Return the mean over tests of shares inside, and its standard error; None of one test."""
    error = float(shares.std(ddof=1) / np.sqrt(shares.size)) if shares.size > 1 else None
    return {"covered": float(np.mean(shares)), "covered_error": error}
