"""How far a model can be trusted, as figures: parameters, residuals, bands, searches."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from hitchid.model import (
    Band,
    Bands,
    Channel,
    Characteristics,
    Comparison,
    Estimates,
    Quantity,
    SearchSummary,
    Uncertainty,
)
from hitchid.model.bands import free_run_half_width
from hitchid.model.ensemble import ensemble_deviations
from hitchid.structures import Batch
from hitchid.validation.residuals import residual_tests

COVERAGE = 0.9


def trust_figures(uncertainty: Uncertainty, comparison: Comparison, factor: float = 1.0) -> dict:
    """Return what identification found of parameters and searches, as JSON can hold it.

    Args:
        uncertainty: of a channel.
        comparison: what was fitted to the same tests for comparison.
        factor: from the model's unit of displacement to that of the figures, for errors; parameters stay in
            the model's units, which are told with them.
    """
    figures = {"parameters": parameter_figures(uncertainty.benchmark, factor)}
    if uncertainty.characteristics is not None:
        figures["characteristics"] = characteristic_figures(uncertainty.characteristics)
    if comparison.paper_estimates is not None:
        figures["paper_parameters"] = parameter_figures(comparison.paper_estimates, factor)
    if comparison.searches:
        figures["searches"] = {search.name: _search_figures(search, factor) for search in comparison.searches}
    return figures


def parameter_figures(estimates: Estimates, factor: float = 1.0) -> dict:
    """Return estimates, what follows from them, and their correlation, as JSON can hold them.

    Args:
        estimates: the estimates.
        factor: as for `trust_figures`.
    """
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
                "bootstrap_95": None if estimate.bootstrap is None else list(estimate.bootstrap),
                "determined": estimate.determined,
                "verdict": estimate.verdict,
                "sensitivity": estimate.sensitivity,
                "bounds": [estimate.lower, estimate.upper],
                "profile": [[value, factor * rmse] for value, rmse in estimate.profile],
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


def characteristic_figures(characteristics: Characteristics) -> dict:
    """Return speed map, dead zone, delay and response time, as JSON can hold them, in the model's units."""
    return {
        "command_unit": characteristics.command_unit,
        "speed_unit": characteristics.speed_unit,
        "load": characteristics.load,
        "dead_zone": _quantity_figures(characteristics.dead_zone),
        "flow_begins": _quantity_figures(characteristics.opening),
        "step_command": characteristics.level,
        "delay_s": _quantity_figures(characteristics.delay),
        "response_time_s": _quantity_figures(characteristics.response_time),
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


def _quantity_figures(quantity: Quantity | None) -> dict | None:
    if quantity is None:
        return None
    lower, upper = quantity.interval
    return {"value": quantity.value, "lower": lower, "upper": upper, "determined": quantity.determined}


def _search_figures(search: SearchSummary, factor: float) -> dict:
    """Return how one search went from its seeds: ends, effort, and the median run, step by step."""
    return {
        "seeds": len(search.rmse),
        "rmse": [_scale(error, factor) for error in search.rmse],
        "evaluations": list(search.evaluations),
        "failures": list(search.failures),
        "median_run": {
            "rmse": [_scale(error, factor) for error in search.median_rmse],
            "values": [list(row) for row in search.median_values],
        },
    }


def _scale(error: float | None, factor: float) -> float | None:
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
    loss_mask = np.asarray(batch.loss_mask)
    simulated = np.asarray(channel.simulate(batch))
    with np.errstate(over="ignore", invalid="ignore"):
        diverged = not all(np.isfinite(np.sum(rows[loss_mask] ** 2)) for rows in (predicted, simulated))
    if diverged:
        return None
    speed = np.gradient(simulated, batch.step_s, axis=1)

    def rows(values: np.ndarray) -> list[np.ndarray]:
        return [row[mask] for row, mask in zip(np.asarray(values), loss_mask, strict=True)]

    findings = residual_tests(
        rows(factor * (np.asarray(batch.displacement) - predicted)),
        rows(np.asarray(batch.command)),
        rows(factor * simulated),
        rows(factor * speed),
        step_s=batch.step_s,
    )
    return asdict(findings)


def free_run_band(channel: Channel, bands: Bands, batch: Batch) -> np.ndarray:
    """Return the half width of the band around the free run, in the model's unit, shape [T, N].

    Args:
        channel, bands: of the model.
        batch: tests.
    """
    _, deviations = ensemble_deviations(channel, bands.ensemble, batch)
    return free_run_half_width([bands], [np.sqrt(np.sum(deviations**2, axis=0))], COVERAGE)


def band_figures(
    bands: Bands,
    batch: Batch,
    simulated: np.ndarray,
    half_width: np.ndarray,
    multi_step: np.ndarray,
    steps: Sequence[int],
    factor: float,
) -> dict:
    """Return what share of unseen samples bands cover, each test weighing the same, and how wide they are.

    Args:
        bands: of the channel.
        batch: tests.
        simulated, half_width: the free run and the half width of its band, shape [T, N].
        multi_step: predictions over horizons, shape [H, T, N].
        steps: the horizons.
        factor: from the model's unit of displacement to that of the figures.
    """
    loss_mask, measured = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    horizon_masks = [loss_mask & (np.arange(loss_mask.shape[1]) >= step) for step in steps]
    widths = [bands.half_width(COVERAGE, step) for step in steps]
    return {
        "coverage": COVERAGE,
        "calibrated_on": {"free_run": bands.tests[0], "horizons": bands.tests[1]},
        "sensor_noise": factor * bands.noise,
        "free_run": {
            **_coverage_figures(_shares(np.abs(measured - simulated) <= half_width, loss_mask)),
            "width": factor * float(np.mean(2 * half_width[loss_mask])),
        },
        "horizons": {
            "steps": list(steps),
            "covered": [
                float(np.mean(_shares(np.abs(measured - rows) <= width, mask)))
                for rows, width, mask in zip(multi_step, widths, horizon_masks, strict=True)
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
    figures = {**_coverage_figures(np.array(shares)), "width": float(np.mean(widths))}
    return {"coverage": COVERAGE, "free_run": figures}


def _shares(inside: np.ndarray, loss_mask: np.ndarray) -> np.ndarray:
    """Return the share of samples inside, of each test that has any."""
    counts = loss_mask.sum(axis=1)
    return (inside & loss_mask).sum(axis=1)[counts > 0] / counts[counts > 0]


def _coverage_figures(shares: np.ndarray) -> dict[str, float | None]:
    """Return the mean over tests of shares inside, and its standard error; None of one test."""
    error = float(shares.std(ddof=1) / np.sqrt(shares.size)) if shares.size > 1 else None
    return {"covered": float(np.mean(shares)), "covered_error": error}
