"""Errors of a prediction against what was measured: pure functions of arrays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

HORIZONS = (1, 2, 5, 10, 20, 50, 100)  # samples predicted ahead, as metrics.json lists them
MIN_IMPROVEMENT = 1.02  # ratio of RMSE: 2 % better
MIN_WIN_RATE = 2 / 3  # share of tests on which a better model must be better
# Tests from which on one standard error (84 %, one-sided) proves a difference; with fewer, 90 %.
MIN_TESTS, ONE_SIGMA_LEVEL, FEW_TESTS_LEVEL = 6, 0.84, 0.9
ERROR_FLOOR = 1e-300  # smallest error taken, so that its logarithm is finite


class ErrorFigures(NamedTuple):
    """How far predictions lie from measurements, pooled over tests.

    Attributes:
        rmse: root mean square error, in the displacement's unit.
        mae: mean absolute error, in the displacement's unit.
        r2: coefficient of determination, a fraction; the spread is taken about each test's own mean.
        fit: 100 (1 − ‖y − ŷ‖ / ‖y − ȳ‖), percent; ȳ is each test's own mean.
        max_abs: largest absolute error, in the displacement's unit.
        within_1: fraction of samples whose absolute error is below one unit.
    """

    rmse: float
    mae: float
    r2: float
    fit: float
    max_abs: float
    within_1: float


def error_figures(actual: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> ErrorFigures:
    """Compare predictions with measurements, test by test, pooled over all samples.

    R² = 1 − Σ(y − ŷ)² / Σ(y − ȳ)². The mean is each test's own, so tests that start at different heights do
    not lend each other spread.

    Args:
        actual: measured displacement, one array of shape [N_i] for each test.
        predicted: predicted displacement, of the same shapes and unit.

    Returns:
        The pooled figures; `r2` and `fit` are 0 and the error counts in full where nothing moved.
    """
    error = np.concatenate([np.asarray(p) - np.asarray(a) for a, p in zip(actual, predicted, strict=True)])
    moving_tests = [np.asarray(a) for a in actual if np.ptp(a) > 0]
    spread = float(sum(np.sum((a - np.mean(a)) ** 2) for a in moving_tests))
    squared_error = float(np.sum(error**2))
    ratio = squared_error / spread if spread > 0 else 1.0
    return ErrorFigures(
        rmse=float(np.sqrt(np.mean(error**2))),
        mae=float(np.mean(np.abs(error))),
        r2=1.0 - ratio,
        fit=100.0 * (1.0 - float(np.sqrt(ratio))),
        max_abs=float(np.max(np.abs(error))),
        within_1=float(np.mean(np.abs(error) < 1.0)),
    )


def rmse_error(actual: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> float:
    """Return the standard error of the pooled root mean square error, with tests as what is independent.

    The jackknife, s² = (T − 1)/T Σ (r_t − r̄)², r_t being the figure without test t.

    Args:
        actual, predicted: as for `error_figures`.

    Returns:
        In the displacement's unit; NaN where there is one test alone.
    """
    errors = [np.asarray(p) - np.asarray(a) for a, p in zip(actual, predicted, strict=True)]
    tests = len(errors)
    if tests < 2:
        return float("nan")
    sums, counts = np.array([np.sum(e**2) for e in errors]), np.array([e.size for e in errors])
    with np.errstate(invalid="ignore", over="ignore"):  # not finite where a prediction diverged
        leave_one_out = np.sqrt((sums.sum() - sums) / (counts.sum() - counts))
    return float(np.sqrt((tests - 1) / tests * np.sum((leave_one_out - leave_one_out.mean()) ** 2)))


def significantly_better(errors: np.ndarray, other_errors: np.ndarray, samples: np.ndarray) -> bool:
    """Return whether one model has a significantly smaller error than another over the same tests.

    d = ln r_than − ln r over all samples, its standard error s by the jackknife over the tests that both were
    run on; d/s is held against Student's t with T − 1 degrees of freedom, one-sided 2.5 %. Logarithms, for
    errors scatter from test to test by factors.

    Args:
        errors, other_errors: root mean square error of each test, of the one and of the other, shape [T];
            infinite where a model diverged.
        samples: how many samples each test has, shape [T].

    Returns:
        False too where there is one test alone.
    """
    tests = errors.size
    if not np.all(np.isfinite(errors)) or tests < 2:
        return False
    if not np.all(np.isfinite(other_errors)):
        return True

    def log_ratio(selected: np.ndarray) -> float:
        pooled = [
            np.sqrt(np.average(test_errors[selected] ** 2, weights=samples[selected]))
            for test_errors in (other_errors, errors)
        ]
        return float(np.log(pooled[0]) - np.log(pooled[1]))

    test_indices = np.arange(tests)
    with np.errstate(divide="ignore", invalid="ignore"):
        overall = log_ratio(test_indices >= 0)
        leave_one_out = np.array([log_ratio(test_indices != omitted) for omitted in test_indices])
    if not np.all(np.isfinite(leave_one_out)):  # a model without any error has no logarithm
        return bool(np.all(errors < other_errors))
    error = np.sqrt((tests - 1) / tests * np.sum((leave_one_out - leave_one_out.mean()) ** 2))
    return bool(overall > stdtrit(tests - 1, 0.975) * error)


def proven_better(errors: np.ndarray, other_errors: np.ndarray) -> bool:
    """Return whether held-out tests prove one model better than another.

    It is better by 2 % in root mean square over all tests, on two thirds of them, and the mean of ln(r₂/r)
    lies above zero by a standard error, r₂ being the error of the other: by Student's t at 84 %, one-sided,
    and with fewer than six tests, whose scatter is itself uncertain, at 90 %. No single test decides.
    Logarithms, for errors scatter by factors.

    Args:
        errors, other_errors: root mean square error of each test, of the one and of the other, shape [T].
    """
    rmse, other_rmse = (float(np.sqrt(np.mean(test_errors**2))) for test_errors in (errors, other_errors))
    tests = errors.size
    if tests < 2 or not (
        MIN_IMPROVEMENT * rmse < other_rmse and float(np.mean(errors < other_errors)) >= MIN_WIN_RATE
    ):
        return False
    log_ratios = np.log(np.maximum(other_errors, ERROR_FLOOR) / np.maximum(errors, ERROR_FLOOR))
    required = float(stdtrit(tests - 1, ONE_SIGMA_LEVEL if tests >= MIN_TESTS else FEW_TESTS_LEVEL))
    return bool(log_ratios.mean() > required * log_ratios.std(ddof=1) / np.sqrt(tests))
