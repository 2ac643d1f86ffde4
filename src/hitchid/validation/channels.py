"""One channel and its baselines on unseen tests."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hitchid._support.metrics import HORIZONS
from hitchid.baselines.registry import Persistence, delayed
from hitchid.logs.record import Record
from hitchid.model import Band, Bands, Channel, Estimates, Rivals, Uncertainty, remove_padding
from hitchid.model.bands import free_run_half_width
from hitchid.model.free_run import ensemble_deviations
from hitchid.structures import Batch
from hitchid.validation.residuals import ResidualTests, residual_tests
from hitchid.validation.results import (
    BENCHMARK,
    FREE_RUN,
    GREYBOX,
    ONE_STEP,
    PERSISTENCE,
    Accuracy,
    BandFigures,
    BandHorizons,
    ChannelResult,
    Horizons,
    ModelFigures,
    Predictions,
    RunFigures,
    figures_by_test,
)

# Coverage of prediction bands on unseen tests and cycles.

COVERAGE = 0.9  # share of samples, the level of the bands that are validated


def band_figures(
    bands: Bands,
    batch: Batch,
    simulated: np.ndarray,
    half_width: np.ndarray,
    multi_step: Sequence[np.ndarray],
    steps: Sequence[int],
    factor: float,
) -> BandFigures:
    """Return the share of unseen samples inside the bands, each test weighing the same, and their width.

    Free run and half width have shape [T, N], predictions shape [T, N] for each horizon; the factor leads to
    the unit of the figures.
    """
    loss_mask, measured = np.asarray(batch.loss_mask), np.asarray(batch.displacement)
    horizon_masks = [loss_mask & (np.arange(loss_mask.shape[1]) >= step) for step in steps]
    half_widths = [
        bands.half_width(COVERAGE, step, rows - delayed(measured, step))
        for rows, step in zip(multi_step, steps, strict=True)
    ]
    covered, error = _mean_share(_shares(np.abs(measured - simulated) <= half_width, loss_mask))
    return BandFigures(
        coverage=COVERAGE,
        covered=covered,
        covered_error=error,
        width=factor * float(np.mean(2 * half_width[loss_mask])),
        calibrated_on=bands.tests,
        sensor_noise=factor * bands.noise,
        horizons=BandHorizons(
            steps=tuple(steps),
            covered=tuple(
                float(np.mean(_shares(np.abs(measured - rows) <= width, mask)))
                for rows, width, mask in zip(multi_step, half_widths, horizon_masks, strict=True)
            ),
            width=tuple(
                2 * factor * float(np.mean(width[mask]))
                for width, mask in zip(half_widths, horizon_masks, strict=True)
            ),
        ),
    )


def cycle_band_figures(bands: Sequence[Band], actual: Sequence[np.ndarray]) -> BandFigures:
    """Return the share of samples of unseen cycles inside bands around the free run, and their width."""
    pairs = list(zip(bands, actual, strict=True))
    covered, error = _mean_share(
        np.array([np.mean((lower <= y) & (y <= upper)) for (lower, upper), y in pairs])
    )
    width = float(np.mean([np.mean(upper - lower) for lower, upper in bands]))
    return BandFigures(COVERAGE, covered, error, width)


def _shares(inside: np.ndarray, loss_mask: np.ndarray) -> np.ndarray:
    """Return the share of samples inside for each test that has samples."""
    counts = loss_mask.sum(axis=1)
    return (inside & loss_mask).sum(axis=1)[counts > 0] / counts[counts > 0]


def _mean_share(shares: np.ndarray) -> tuple[float, float | None]:
    """Return the mean over tests of shares inside, and its standard error; None for one test."""
    error = float(shares.std(ddof=1) / np.sqrt(shares.size)) if shares.size > 1 else None
    return float(np.mean(shares)), error


class _ModelRuns(NamedTuple):
    """Predictions of a channel and its baselines, in the model's unit, rows of shape [T, N].

    `multi_step` has one entry per horizon, in samples; models without a predictor simulate from the last
    measured displacement.
    """

    batch: Batch
    steps: list[int]
    benchmark: np.ndarray
    free_run: np.ndarray
    multi_step: dict[str, list[np.ndarray]]
    baselines: dict[str, "_BaselineRun"]


def channel_result(
    channel: Channel, tests: Sequence[Record], factor: float, uncertainty: Uncertainty | None, rivals: Rivals
) -> ChannelResult:
    """Return the results of a channel on unseen tests.

    Tests are on the model's clock and in its units; the factor leads to the unit of the figures.
    """
    runs = _run(channel, rivals, tests)
    half_width = _half_width(channel, runs, uncertainty)
    multi_step = runs.multi_step[GREYBOX]
    accuracy = _accuracy(runs, tests, factor, half_width)
    if uncertainty is not None and uncertainty.bands is not None and half_width is not None:
        bands = band_figures(
            uncertainty.bands, runs.batch, runs.free_run, half_width, multi_step, runs.steps, factor
        )
        accuracy = replace(accuracy, bands=bands)
    residuals = {
        ONE_STEP: _residual_tests(runs, multi_step[0], factor),
        FREE_RUN: _residual_tests(runs, runs.free_run, factor),
    }
    if uncertainty is None:
        return ChannelResult(accuracy, residuals)
    paper = rivals.paper_estimates
    return ChannelResult(
        accuracy,
        residuals,
        parameters=_with_profiles_scaled(uncertainty.benchmark, factor),
        paper_parameters=paper and _with_profiles_scaled(paper, factor),
        characteristics=uncertainty.characteristics,
        load_scatter=uncertainty.load_scatter,
        searches=tuple(search.scaled(factor) for search in rivals.searches),
    )


def _run(channel: Channel, rivals: Rivals, tests: Sequence[Record]) -> _ModelRuns:
    batch = channel.batch(tests)
    steps = [h for h in HORIZONS if h < min(map(len, tests))]
    benchmark = np.asarray(channel.simulate_benchmark(batch))
    measured = np.asarray(batch.displacement)

    def restarted(simulated: np.ndarray) -> list[np.ndarray]:
        return [delayed(measured, h) + simulated - delayed(simulated, h) for h in steps]

    # What only simulates is carried on from the last measured displacement, so that all have every horizon.
    baselines = _baseline_runs(channel, rivals, tests, steps)
    multi_step = {
        PERSISTENCE: Persistence().predict(batch, steps),
        BENCHMARK: restarted(benchmark),
        GREYBOX: list(np.asarray(channel.predict(batch, tuple(steps)))),
        **{name: baseline.multi_step or restarted(baseline.free_run) for name, baseline in baselines.items()},
    }
    return _ModelRuns(batch, steps, benchmark, np.asarray(channel.simulate(batch)), multi_step, baselines)


def _half_width(channel: Channel, runs: _ModelRuns, uncertainty: Uncertainty | None) -> np.ndarray | None:
    """Return the half width of the band around the free run; None where there is none, or it diverged."""
    if uncertainty is None or uncertainty.bands is None:
        return None
    bands = uncertainty.bands
    _, deviations = ensemble_deviations(channel, bands.ensemble, runs.batch)
    half_width = free_run_half_width([bands], [np.sqrt(np.sum(deviations**2, axis=0))], COVERAGE)
    return half_width if np.all(np.isfinite(runs.free_run)) and np.all(np.isfinite(half_width)) else None


def _accuracy(
    runs: _ModelRuns, tests: Sequence[Record], factor: float, half_width: np.ndarray | None
) -> Accuracy:
    """Return figures of every model, over horizons and by test, with the predictions."""
    predictions = _predictions(runs, half_width, tests, factor)

    def figures(rows: np.ndarray, skip: int = 0) -> RunFigures:
        predicted = [factor * row for row in remove_padding(rows, tests)]
        return RunFigures.of([a[skip:] for a in predictions.actual], [p[skip:] for p in predicted])

    baselines = {
        name: ModelFigures(
            figures(baseline.multi_step[0], 1) if baseline.multi_step else None, figures(baseline.free_run)
        )
        for name, baseline in runs.baselines.items()
    }
    return Accuracy(
        models={
            PERSISTENCE: ModelFigures(one_step=figures(runs.multi_step[PERSISTENCE][0], 1)),
            **baselines,
            BENCHMARK: ModelFigures(free_run=figures(runs.benchmark)),
            GREYBOX: ModelFigures(figures(runs.multi_step[GREYBOX][0], 1), figures(runs.free_run)),
        },
        horizons=Horizons.of(
            {
                name: {h: figures(row, h) for h, row in zip(runs.steps, rows, strict=True)}
                for name, rows in runs.multi_step.items()
            }
        ),
        per_test=figures_by_test(predictions),
        predictions=predictions,
    )


def _predictions(
    runs: _ModelRuns, half_width: np.ndarray | None, tests: Sequence[Record], factor: float
) -> Predictions:
    models = {
        BENCHMARK: runs.benchmark,
        ONE_STEP: runs.multi_step[GREYBOX][0],
        FREE_RUN: runs.free_run,
        **{name: baseline.free_run for name, baseline in runs.baselines.items()},
    }
    without_padding = {name: remove_padding(rows, tests) for name, rows in models.items()}
    ends = None
    if half_width is not None:
        lower, upper = runs.free_run - half_width, runs.free_run + half_width
        ends = remove_padding(lower, tests), remove_padding(upper, tests)
    return Predictions.of(tests, without_padding, factor, band=ends)


def _residual_tests(runs: _ModelRuns, predicted: np.ndarray, factor: float) -> ResidualTests | None:
    """Test the errors of predictions, rows of shape [T, N]; None where they or the free run diverged."""
    batch = runs.batch
    loss_mask = np.asarray(batch.loss_mask)
    simulated = runs.free_run
    with np.errstate(over="ignore", invalid="ignore"):
        # A speed looks a sample beyond those that count, where the run may have diverged.
        speed = np.gradient(simulated, batch.step_s, axis=1)
        if not all(np.isfinite(np.sum(rows[loss_mask] ** 2)) for rows in (predicted, simulated, speed)):
            return None

    def rows(values: np.ndarray) -> list[np.ndarray]:
        return [row[mask] for row, mask in zip(np.asarray(values), loss_mask, strict=True)]

    return residual_tests(
        rows(factor * (np.asarray(batch.displacement) - predicted)),
        rows(np.asarray(batch.command)),
        rows(factor * simulated),
        rows(factor * speed),
        step_s=batch.step_s,
    )


def _with_profiles_scaled(estimates: Estimates, factor: float) -> Estimates:
    """Return estimates with the RMSE of their profiles in the unit of the figures."""
    parameters = (
        replace(estimate, profile=tuple((value, factor * rmse) for value, rmse in estimate.profile))
        for estimate in estimates.parameters
    )
    return replace(estimates, parameters=tuple(parameters))


class _BaselineRun(NamedTuple):
    """Displacement of a baseline in free run, shape [T, N], and h samples ahead; None without a predictor."""

    free_run: np.ndarray
    multi_step: list[np.ndarray] | None = None


def _baseline_runs(
    channel: Channel, rivals: Rivals, tests: Sequence[Record], steps: Sequence[int]
) -> dict[str, _BaselineRun]:
    """Return the runs of the baselines, by name; none of those whose covariate a test lacks."""
    runs, covariates = {}, rivals.covariates
    if all(name in record.signals for record in tests for name in covariates):
        batch = channel.batch(tests, covariates=covariates)
        runs = {
            name: _BaselineRun(_limited(channel, batch, fitted.free_run(batch)), fitted.predict(batch, steps))
            for name, fitted in rivals.baselines.items()
        }
    paper = paper_channel(channel, rivals)
    if paper is not None:
        batch = channel.batch(tests).with_dead_zone(paper.dead_zone)
        runs["transfer_function"] = _BaselineRun(np.asarray(paper.simulate_benchmark(batch)))
        if paper.compensator is not None:
            rows = list(np.asarray(paper.predict(batch, tuple(steps))))
            runs["paper"] = _BaselineRun(np.asarray(paper.simulate_closed_loop(batch)), rows)
    return runs


def _limited(channel: Channel, batch: Batch, displacement: np.ndarray) -> np.ndarray:
    """Return the free run of a baseline within the end stop and the limits, as that of the grey box is.

    What is not finite stays: a free run that diverged is not to be mistaken for one at its limit.
    """
    travel = batch.sign * (displacement - np.asarray(batch.initial)[:, None])
    return np.where(
        np.isfinite(travel), np.asarray(channel.limited(batch, jnp.asarray(travel))), displacement
    )


def paper_channel(channel: Channel, rivals: Rivals) -> Channel | None:
    """Return the channel by the method of Sun et al. 2025: the channel itself if its benchmark is linear.

    None where it was not fitted, or no baselines were.
    """
    if rivals.paper is not None:
        return rivals.paper
    physical_model = channel.benchmark
    is_linear = physical_model.structure.linear is not None and physical_model.nonlinearity is None
    return channel if is_linear and rivals.baselines else None
