"""Prediction bands: how far what is measured may lie from what is predicted, calibrated test by test."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from hitchid.errors import InputError

LEVELS = (0.5, 0.8, 0.9, 0.95)
GRID = np.linspace(0.0, 1.0, 401)
BISECTION_STEPS = 12
SMALLEST = 1e-12


@dataclass(frozen=True)
class EnsembleMember:
    """A channel that might as well be the true one, for the next test.

    Attributes:
        benchmark: parameters of the structure, dead time, and curves where there are any, in one row.
        member: number of the network that alone corrects the free run; None for all together.
        weight: by which its distance counts.
    """

    benchmark: tuple[float, ...]
    member: int | None = None
    weight: float = 1.0


@dataclass(frozen=True)
class Bands:
    """What a band around a channel's predictions is made of.

    In free run its half width is √(z² n² + q² Σ w² (y_a − y)²): n the noise of the sensor and z its normal
    quantile, y_a the free runs of alternatives and w their weights, q found from tests that were held out.

    Attributes:
        alternatives: channels that might as well be the true one.
        noise: standard deviation of the sensor's noise, in the displacement's unit.
        levels: shares of samples that bands may be asked to cover, ascending.
        free_run: q for each of them.
        horizons: samples looked ahead, ascending.
        ahead: half width for each horizon and level, in the displacement's unit.
        tests: held-out tests they were found from, for free run and for looking ahead.
    """

    alternatives: tuple[EnsembleMember, ...]
    noise: float
    levels: tuple[float, ...]
    free_run: tuple[float, ...]
    horizons: tuple[int, ...]
    ahead: tuple[tuple[float, ...], ...]
    tests: tuple[int, int]

    def multiplier(self, coverage: float) -> float:
        """Return q for a share of samples, interpolated between the levels.

        Raises:
            InputError: the share lies beyond the levels.
        """
        return float(np.interp(self._checked_coverage(coverage), self.levels, self.free_run))

    def free_run_half_width(self, coverage: float, spread: np.ndarray) -> np.ndarray:
        """Return half widths in free run, in the displacement's unit.

        Args:
            coverage: share of samples.
            spread: √(Σ w² (y_a − y)²) at each sample.
        """
        floor = float(ndtri(0.5 + coverage / 2)) * self.noise
        return np.hypot(floor, self.multiplier(coverage) * spread)

    def half_width(self, coverage: float, horizon: int) -> float:
        """Return the half width so many samples ahead, interpolated between horizons and levels.

        Raises:
            InputError: the share lies beyond the levels.
        """
        by_level = [np.interp(self._checked_coverage(coverage), self.levels, row) for row in self.ahead]
        return float(np.interp(np.log(horizon), np.log(self.horizons), by_level))

    def _checked_coverage(self, coverage: float) -> float:
        if not self.levels[0] <= coverage <= self.levels[-1]:
            raise InputError(
                f"coverage: required between {self.levels[0]:g} and {self.levels[-1]:g}, came {coverage:g}"
            )
        return coverage


def nonconformity_scores(
    errors: Sequence[np.ndarray], spreads: Sequence[np.ndarray], noise: float, level: float
) -> list[np.ndarray]:
    """Return the q that each sample needs to lie in its band.

    Args:
        errors: measured less predicted, one array of shape [N_i] for each test that was held out.
        spreads: root of the sum of squares over alternatives, of the same shapes.
        noise: standard deviation of the sensor's noise.
        level: share of samples the band shall cover.
    """
    floor = (float(ndtri(0.5 + level / 2)) * noise) ** 2
    return [
        np.sqrt(np.maximum(error**2 - floor, 0.0)) / np.maximum(spread, SMALLEST)
        for error, spread in zip(errors, spreads, strict=True)
    ]


def conformal_quantile(scores: Sequence[np.ndarray], level: float) -> float:
    """Return the score below which a share of the samples of a test not seen lies, on average over tests.

    Samples of one test stand and fall together, so the quantile over all samples covers fewer than it says.
    The probability p is therefore raised until each test, judged by the quantile p of the others, is covered
    to the level asked for, on average; the mean of these quantiles is returned. Every test weighs the same.
    With tests exchangeable this is the conformal prediction of Vovk et al. (2005, Algorithmic Learning in a
    Random World, ch. 2), with tests for samples.

    Args:
        scores: of tests that were held out, one array of shape [N_i] each.
        level: share of samples.
    """
    rows = np.stack([np.quantile(row, GRID) for row in scores])
    if len(rows) == 1:
        return float(rows.max())
    others = [np.sort(np.delete(rows, test_index, axis=0), axis=None) for test_index in range(len(rows))]
    shares = np.linspace(0.0, 1.0, others[0].size)

    def limits(probability: float) -> list[float]:
        return [float(np.interp(probability, shares, quantiles)) for quantiles in others]

    def mean_coverage(probability: float) -> float:
        pairs = zip(rows, limits(probability), strict=True)
        return float(np.mean([np.interp(limit, row, GRID, left=0.0, right=1.0) for row, limit in pairs]))

    if mean_coverage(1.0) < level:
        return float(rows.max())
    low, high = level, 1.0
    for _ in range(BISECTION_STEPS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if mean_coverage(middle) >= level else (middle, high)
    return float(np.mean(limits(low if mean_coverage(low) >= level else high)))


def sensor_noise(errors: Sequence[np.ndarray]) -> float:
    """Return the standard deviation of white noise on errors that otherwise change smoothly.

    σ² = mean (Δ³e)²/20: the third difference of white noise has 1 + 9 + 9 + 1 times its variance, that of
    what is smooth nearly none. The median of tests is taken.

    Args:
        errors: measured less predicted, one array of shape [N_i] for each test.
    """
    deviations = [np.sqrt(np.mean(np.diff(error, 3) ** 2) / 20) for error in errors if error.size > 3]
    return float(np.median(deviations)) if deviations else 0.0
