"""Error figures of predictions against measurements, and tests of their significance."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

HORIZONS = (1, 2, 5, 10, 20, 50, 100)  # samples predicted ahead, as listed in metrics.json
MIN_IMPROVEMENT = 1.02  # ratio of RMSE: 2 % better (chosen)
# Level of all comparisons of one choice on held-out tests, one-sided. Chosen: a larger model that is not
# needed costs little, one that is missed biases every figure.
HELD_OUT_LEVEL = 0.1
SIGNIFICANCE = 0.025  # level of one-sided tests between two models, 5 % for both directions (chosen)
ROUNDING = 1e-12  # share of a mean below which a standard error is rounding alone
ERROR_FLOOR = 1e-300  # lower limit of an error, so that its logarithm is finite (chosen)


class ErrorFigures(NamedTuple):
    """Error figures of predictions, pooled over tests.

    Attributes:
        rmse: root mean square error, in the displacement's unit.
        mae: mean absolute error, in the displacement's unit.
        r2: coefficient of determination, a fraction; variance about each test's own mean.
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
    """Return the error figures of predictions, pooled over all samples of all tests.

    R² = 1 − Σ(y − ŷ)² / Σ(y − ȳ)². The mean is each test's own, so different start positions of the tests do
    not add to the variance.

    Args:
        actual: measured displacement, one array of shape [N_i] for each test.
        predicted: predicted displacement, of the same shapes and unit.

    Returns:
        The pooled figures; `r2` and `fit` are 0 if no test has motion. Tests without motion add error only.
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
    """Return the standard error of the pooled root mean square error; NaN for a single test.

    Tests are independent: the jackknife, s² = (T − 1)/T Σ (r_t − r̄)², r_t being the figure without test t.
    """
    errors = [np.asarray(p) - np.asarray(a) for a, p in zip(actual, predicted, strict=True)]
    tests = len(errors)
    if tests < 2:
        return float("nan")
    sums, counts = np.array([np.sum(e**2) for e in errors]), np.array([e.size for e in errors])
    with np.errstate(invalid="ignore", over="ignore"):  # not finite where a prediction diverged
        leave_one_out = np.sqrt((sums.sum() - sums) / (counts.sum() - counts))
    return float(np.sqrt((tests - 1) / tests * np.sum((leave_one_out - leave_one_out.mean()) ** 2)))


def better_p_value(errors: np.ndarray, other_errors: np.ndarray, samples: np.ndarray) -> float:
    """Return the one-sided p-value of one model having a smaller error than another over the same tests.

    d = ln r₂ − ln r over all samples, r₂ being the error of the other model; its standard error s is by the
    jackknife over the tests. d/s is compared with Student's t at T − 1 degrees of freedom. Logarithms are
    used since errors of tests differ by factors. 1 for a single test, and for a model that diverged, whose
    errors are infinite.
    """
    tests = errors.size
    if not np.all(np.isfinite(errors)) or tests < 2:
        return 1.0
    if not np.all(np.isfinite(other_errors)):
        return 0.0

    def log_ratio(selected: np.ndarray) -> float:
        pooled = [
            np.sqrt(np.average(test_errors[selected] ** 2, weights=samples[selected]))
            for test_errors in (other_errors, errors)
        ]
        return float(np.log(pooled[0]) - np.log(pooled[1]))

    # Errors of one test are correlated, so tests are left out, not samples.
    test_indices = np.arange(tests)
    with np.errstate(divide="ignore", invalid="ignore"):
        overall = log_ratio(test_indices >= 0)
        leave_one_out = np.array([log_ratio(test_indices != omitted) for omitted in test_indices])
    if not np.all(np.isfinite(leave_one_out)):  # the logarithm of a zero error is infinite
        return 0.0 if np.all(errors < other_errors) else 1.0
    error = np.sqrt((tests - 1) / tests * np.sum((leave_one_out - leave_one_out.mean()) ** 2))
    if error == 0:
        return 0.0 if overall > 0 else 1.0
    return float(stdtr(tests - 1, -overall / error))


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Return p-values adjusted for the number of comparisons, at most 1 (Holm 1979).

    The k-th smallest of m is multiplied by m − k + 1, and is at least the adjusted one before it. Where all
    adjusted values below a level α count as significant, the probability of any false one is at most α.
    """
    order = np.argsort(p_values, kind="stable")
    factors = np.arange(len(order), 0, -1)
    adjusted = np.empty(len(order))
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(factors * np.asarray(p_values)[order]))
    return tuple(adjusted.tolist())


def better_on_held_out_tests(errors: np.ndarray, other_errors: np.ndarray, comparisons: int = 1) -> bool:
    """Return whether one model is better than another on held-out tests, significantly and by 2 %.

    Both conditions: a root mean square error smaller by 2 % over all tests (a smaller difference has no
    use), and `log_ratio_p_value` below 10 % divided by the number of comparisons (Bonferroni): where the
    models of so many comparisons are equally good, any is found better with a probability of at most 10 %.
    """
    if not errors.size:  # where all tests that are held out are of one fold, no other has chosen
        return False
    rmse, other_rmse = (float(np.sqrt(np.mean(test_errors**2))) for test_errors in (errors, other_errors))
    is_relevant = MIN_IMPROVEMENT * rmse < other_rmse
    return is_relevant and log_ratio_p_value(errors, other_errors) < HELD_OUT_LEVEL / comparisons


def independent_observations(errors: np.ndarray) -> float:
    """Return the number of independent errors that weigh as much as the correlated ones of all tests, n/τ.

    τ = 1 + 2 Σ ρ(k), ρ(k) the autocorrelation of the errors of all tests together, without their mean taken
    off: what a test has of its own is one error, not as many as samples. The sum ends before the first pair
    of neighbouring lags that is not positive (Geyer 1992, Statistical Science 7, 473).

    Args:
        errors: of the tests, zero where samples do not count, shape [T, N].
    """
    samples = int(np.count_nonzero(errors))
    length = 2 * errors.shape[1]  # zeros behind each test: no lag reaches from its end to its beginning
    spectrum = np.abs(np.fft.rfft(errors, length, axis=1)) ** 2
    correlation = np.fft.irfft(spectrum.sum(axis=0), length)[: errors.shape[1]]
    if correlation[0] <= 0:
        return 0.0
    pairs = correlation[: 2 * (errors.shape[1] // 2)].reshape(-1, 2).sum(axis=1) / correlation[0]
    negative = np.flatnonzero(pairs <= 0)
    time = 2 * pairs[: negative[0] if negative.size else None].sum() - 1
    return samples / max(float(time), 1.0)


def log_ratio_p_value(errors: np.ndarray, other_errors: np.ndarray) -> float:
    """Return the one-sided p-value of one model having smaller errors than another on a typical test.

    The mean of d = ln(r₂/r), r₂ being the error of the other model on a test, over its standard error is
    compared with Student's t at T − 1 degrees of freedom. Logarithms are used since errors of tests differ by
    factors; each test weighs the same. 1 for a single test.
    """
    tests = errors.size
    if tests < 2:
        return 1.0
    log_ratios = np.log(np.maximum(other_errors, ERROR_FLOOR) / np.maximum(errors, ERROR_FLOOR))
    mean, error = float(log_ratios.mean()), float(log_ratios.std(ddof=1) / np.sqrt(tests))
    if error <= ROUNDING * abs(mean):
        return 0.0 if mean > 0 else 1.0
    return float(stdtr(tests - 1, -mean / error))
