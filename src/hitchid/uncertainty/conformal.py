"""Calibration of prediction bands: conformal quantiles of errors, grouped by test."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from hitchid.model.bands import PredictionSpread

LEVELS = (0.5, 0.8, 0.9, 0.95)  # coverages at which bands are calibrated, shares of samples
GRID = np.linspace(0.0, 1.0, 401)  # probabilities at which the quantiles of one test are taken
BISECTION_STEPS = 12  # of the probability: to (1 − level)/4096
ROUNDING = 1e-9  # of level/(1 − level), which is a whole number for levels such as 0.9
SMALLEST = 1e-12  # smallest spread divided by, in the displacement's unit


def nonconformity_scores(
    errors: Sequence[np.ndarray], spreads: Sequence[np.ndarray], noise: float, level: float
) -> list[np.ndarray]:
    """Return for each sample the smallest factor q at which its band contains it.

    The spread is the root of the sum of squared deviations of the ensemble members.
    """
    # The part of a band that is the sensor's noise is not calibrated: an error within it has the score 0.
    floor = (float(ndtri(0.5 + level / 2)) * noise) ** 2
    return [
        np.sqrt(np.maximum(error**2 - floor, 0.0)) / np.maximum(spread, SMALLEST)
        for error, spread in zip(errors, spreads, strict=True)
    ]


def fewest_tests(level: float) -> int:
    """Return the number of tests T from which ⌈(T + 1) level⌉ ≤ T, as conformal prediction requires."""
    return int(np.ceil(level / (1.0 - level) - ROUNDING))


def conformal_quantile(scores: Sequence[np.ndarray], level: float) -> float:
    """Return the score that bounds a share of the samples of an unseen test, on average over tests.

    Samples of one test are correlated, so the quantile over all samples covers less than its probability.
    The probability p is therefore raised until the mean coverage of each test by the quantile p of the other
    tests reaches the level; the mean of these quantiles is returned. Every test has the same weight. With
    fewer tests than `fewest_tests` the score is at least the largest of the tests' own quantiles, so that it
    bounds that share of every held-out test.

    Tests are the exchangeable units of conformal prediction (Vovk et al. 2005, Algorithmic Learning in a
    Random World, ch. 2; Dunn, Wasserman & Ramdas 2022, Distribution-free prediction sets for two-layer
    hierarchical models).
    """
    # Quantiles of each test at GRID: sorting costs a tenth of `np.quantile` at so many.
    rows = np.stack([_interpolate(np.sort(row), GRID * (row.size - 1)) for row in scores])
    # One test has no others to compare it with.
    if len(rows) == 1:
        return float(rows.max())
    # As many grid values of each test: all weigh the same, however long they are.
    order = np.argsort(rows, axis=None)
    sorted_rows, test_indices = rows.ravel()[order], order // GRID.size
    others = np.stack([sorted_rows[test_indices != test] for test in range(len(rows))])

    def limits(probability: float) -> np.ndarray:
        return _interpolate(others, probability * (others.shape[1] - 1))

    def mean_coverage(probability: float) -> float:
        pairs = zip(rows, limits(probability), strict=True)
        return float(np.mean([np.interp(limit, row, GRID, left=0.0, right=1.0) for row, limit in pairs]))

    # All scores of the others cover too little of a test: the largest of all.
    if mean_coverage(1.0) < level:
        return float(rows.max())
    low, high = level, 1.0
    for _ in range(BISECTION_STEPS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if mean_coverage(middle) >= level else (middle, high)
    quantile = float(np.mean(limits(low if mean_coverage(low) >= level else high)))
    if len(rows) >= fewest_tests(level):
        return quantile
    return max(quantile, *(float(np.interp(level, GRID, row)) for row in rows))


def _interpolate(ascending: np.ndarray, positions: np.ndarray | float) -> np.ndarray:
    """Return ascending values at fractional indices, along the last axis."""
    lower = np.floor(positions).astype(int)
    upper = np.minimum(lower + 1, ascending.shape[-1] - 1)
    values = ascending[..., lower]
    return values + (positions - lower) * (ascending[..., upper] - values)


def sensor_noise(errors: Sequence[np.ndarray]) -> float:
    """Return the standard deviation of white noise added to smooth errors, median over tests.

    σ² = mean (Δ³e)²/20: the third difference of white noise has 1 + 9 + 9 + 1 = 20 times its variance, that
    of a smooth signal is close to zero.
    """
    deviations = [np.sqrt(np.mean(np.diff(error, 3) ** 2) / 20) for error in errors if error.size > 3]
    # The median, which one broken test does not move far.
    return float(np.median(deviations)) if deviations else 0.0


def growing_quantiles(
    errors: Sequence[np.ndarray], spreads: Sequence[np.ndarray], noise: float
) -> tuple[float, ...]:
    """Return q for each of `LEVELS`, so that a band of a larger coverage contains that of a smaller one."""
    quantiles = [
        conformal_quantile(nonconformity_scores(errors, spreads, noise, level), level) for level in LEVELS
    ]
    return tuple(map(float, np.maximum.accumulate(quantiles)))


# Spread of predictions by horizon and predicted movement, calibrated on errors of held-out tests.

# Horizons at which errors are measured, in samples; between them everything is interpolated. Chosen: half
# widths of neighbours differ by less than a tenth.
CALIBRATED_HORIZONS = (1, 2, 3, 5, 7, 10, 14, 20, 30, 50, 70, 100)
FURTHER_HORIZONS = (200, 500, 1000)  # where they are no further than a second
# Powers of the movement that are compared; chosen: errors of a wrong gain grow with the movement, those of
# random disturbances with its root, those of a wrong time constant hardly.
EXPONENTS = (0.25, 0.5, 0.75, 1.0)
TINY = np.finfo(np.float64).tiny  # smallest variance, so that its logarithm is finite


class HeldOutErrors(NamedTuple):
    """Errors of predictions over one horizon, one array of shape [N_i] for each held-out test.

    Measured minus predicted, and the movement: predicted minus the last measured displacement, in its unit.
    """

    errors: Sequence[np.ndarray]
    movements: Sequence[np.ndarray]


def prediction_spread(held_out: Mapping[int, HeldOutErrors], noise: float) -> PredictionSpread:
    """Return the spread of predictions, and the factors of its bands.

    The mean square of the errors over a horizon is that of the noise, in the measured displacement and in the
    one that is predicted, and g_h², which thus follows. The exponent is that of the largest likelihood of
    normal errors.
    """
    candidates = [_with_exponent(held_out, noise, exponent) for exponent in EXPONENTS]
    spread = max(candidates, key=lambda candidate: _log_likelihood(candidate, held_out))
    multipliers = tuple(
        growing_quantiles(errors, [spread.spread(horizon, row) for row in movements], noise)
        for horizon, (errors, movements) in held_out.items()
    )
    return replace(spread, multipliers=multipliers)


def _with_exponent(held_out: Mapping[int, HeldOutErrors], noise: float, exponent: float) -> PredictionSpread:
    """Return the spread with a given exponent, without factors."""
    movements, growths = [], []
    for errors, movement_rows in held_out.values():
        # Where nothing moves any movement is typical.
        typical = float(np.sqrt(_mean([row**2 for row in movement_rows]))) or 1.0
        relative = _mean([(np.abs(row) / typical) ** (2 * exponent) for row in movement_rows]) or 1.0
        excess = max(_mean([row**2 for row in errors]) - 2 * noise**2, 0.0)
        movements.append(typical)
        growths.append(float(np.sqrt(excess / relative)))
    return PredictionSpread(noise, exponent, tuple(held_out), tuple(movements), tuple(growths), ())


def _log_likelihood(spread: PredictionSpread, held_out: Mapping[int, HeldOutErrors]) -> float:
    """Return the mean log likelihood of normal errors, up to a constant."""

    def of_test(horizon: int, errors: np.ndarray, movement: np.ndarray) -> np.ndarray:
        variance = np.maximum(spread.noise**2 + spread.spread(horizon, movement) ** 2, TINY)
        return -0.5 * (np.log(variance) + errors**2 / variance)

    means = [
        _mean([of_test(horizon, *pair) for pair in zip(errors, movements, strict=True)])
        for horizon, (errors, movements) in held_out.items()
    ]
    return float(np.mean(means))


def _mean(rows: Sequence[np.ndarray]) -> float:
    """Return the mean over tests of their means: every test has the same weight."""
    return float(np.mean([row.mean() for row in rows]))
