"""Coverage of prediction bands on unseen tests and cycles."""

from collections.abc import Sequence

import numpy as np

from hitchid.baselines.persistence import delayed
from hitchid.model import Band, Bands, Channel
from hitchid.model.bands import free_run_half_width
from hitchid.model.ensemble import ensemble_deviations
from hitchid.structures import Batch
from hitchid.validation.results import BandFigures, BandHorizons

COVERAGE = 0.9  # share of samples, the level of the bands that are validated


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
    multi_step: Sequence[np.ndarray],
    steps: Sequence[int],
    factor: float,
) -> BandFigures:
    """Return the share of unseen samples inside the bands, each test weighing the same, and their width.

    Args:
        bands: of the channel.
        batch: tests.
        simulated, half_width: the free run and the half width of its band, shape [T, N].
        multi_step: predictions over horizons, H arrays of shape [T, N].
        steps: the horizons.
        factor: from the model's unit of displacement to that of the figures.
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
    """Return the share of samples of unseen cycles inside bands around the free run, and their width.

    Args:
        bands: around the free run of each cycle.
        actual: measured displacement, of the same shapes.
    """
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
