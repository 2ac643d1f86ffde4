"""Tests of residuals: whiteness, independence of the command, normality, size by operating point."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtr, ndtri

from hitchid._support.records import short_repr
from hitchid.errors import InputError

LEVEL = 0.01  # significance of every test; chosen
BOUND = float(-ndtri(LEVEL / 2))  # quantile of the standard normal distribution at this level, two-sided
MIN_SAMPLES = 8  # fewest errors that are tested; chosen
MAX_BINS = 8  # bins of a quantity; chosen


@dataclass(frozen=True)
class Bin:
    """The errors where a quantity lies from `lower` to `upper`, the least and the largest value in the bin.

    `mean` and `rmse` are the mean and the root mean square of the bin's `count` errors, in their unit.
    """

    lower: float
    upper: float
    count: int
    mean: float
    rmse: float


@short_repr
@dataclass(frozen=True)
class Binned:
    """Errors by the value of a quantity.

    Attributes:
        share: correlation ratio η² = Σ_b n_b (ē_b − ē)² / Σ (e − ē)², the fraction of the errors' variance
            that the means of the bins explain.
        bins: at most 8, by rising value.
    """

    share: float
    bins: tuple[Bin, ...]


@short_repr
@dataclass(frozen=True)
class ResidualTests:
    """Tests of the errors of a model, all tests together; every decision is taken at 1 %.

    Attributes:
        step_s: sampling time, s.
        count: number of errors N.
        mean, deviation: of the errors, in their unit; the deviation is √(Σ (e − ē)² / N).
        whiteness: Ljung-Box statistic Q.
        freedom: its degrees of freedom, the number of lags h; fitted parameters are not subtracted.
        whiteness_p, white: its p-value, and whether that is at least 1 %.
        autocorrelation: of the errors at lags 1..h.
        autocorrelation_bounds: 2.576/√N_k, exceeded by one lag of white noise in 1 of 100 cases; N_k is the
            number of pairs of samples k apart in the same test.
        cross_lags: −h..h; at lag k the error is compared with the command k samples before it.
        cross_correlation: of errors and command at these lags.
        cross_bounds: bounds that one lag exceeds in 1 of 100 cases if errors and command are independent.
        lags_outside: the lags beyond these bounds; by chance 0.5 of 51 lags on average.
        independence_p, independent: (2h + 1) times the smallest p-value of any lag (Bonferroni), at most 1,
            and whether that is at least 1 %; lags may lie outside the bounds of errors that are independent.
        skewness, excess_kurtosis: of the errors, 0 for a normal distribution.
        normality_p, normal: p-value of Jarque-Bera's test for autocorrelated errors, and whether that is at
            least 1 %.
        by_position, by_speed, by_command: the errors by displacement, speed and command.
    """

    step_s: float
    count: int
    mean: float
    deviation: float
    whiteness: float
    freedom: int
    whiteness_p: float
    white: bool
    autocorrelation: tuple[float, ...]
    autocorrelation_bounds: tuple[float, ...]
    cross_lags: tuple[int, ...]
    cross_correlation: tuple[float, ...]
    cross_bounds: tuple[float, ...]
    lags_outside: tuple[int, ...]
    independence_p: float
    independent: bool
    skewness: float
    excess_kurtosis: float
    normality_p: float
    normal: bool
    by_position: Binned
    by_speed: Binned
    by_command: Binned

    @property
    def by_quantity(self) -> dict[str, Binned]:
        """The errors by displacement (`position`), speed and command."""
        return {"position": self.by_position, "speed": self.by_speed, "command": self.by_command}


def residual_tests(
    errors: Sequence[np.ndarray],
    commands: Sequence[np.ndarray],
    displacements: Sequence[np.ndarray],
    speeds: Sequence[np.ndarray],
    *,
    step_s: float,
    lags: int = 25,
) -> ResidualTests:
    """Test the errors of a model: whiteness, independence of the command, normality; bin by operating point.

    With e and u of pooled mean 0 and mean square 1, and N_k pairs of samples k apart in the same test, the
    autocorrelation is r_k = Σ e(t) e(t − k) / N_k, the cross-correlation the same with u(t − k). Negative
    autocorrelation makes no test stricter than for white errors. Constant errors or commands have
    correlations of 0 and p-values of 1.
    Arrays are finite, of shape [N_i] for each test; commands are effective, in any unit, speeds the model's
    per s. Lags go so far that N_k is at least N/2.

    Raises:
        InputError: there are fewer than 8 samples.
    """
    series = {"errors": errors, "commands": commands, "displacements": displacements, "speeds": speeds}
    tests = {
        name: [np.asarray(test, dtype=np.float64) for test in arrays if np.size(test)]
        for name, arrays in series.items()
    }
    if (samples := sum(test.size for test in tests["errors"])) < MIN_SAMPLES:
        raise InputError(f"expected at least {MIN_SAMPLES} samples, got {samples}")
    size = np.array([test.size for test in tests["errors"]])
    pairs = np.maximum(size[:, None] - np.arange(size.max()), 0).sum(axis=0)
    max_lag = min(lags, int(np.sum(pairs >= int(size.sum()) / 2)) - 1)
    error, mean, deviation = _standardised(tests["errors"])
    command, _, _ = _standardised(tests["commands"])
    of_errors, of_command = (_products(row, row)[size.max() - 1 :] / pairs for row in (error, command))
    lag = np.arange(-max_lag, max_lag + 1)
    cross = _products(error, command)[size.max() - 1 + lag] / pairs[np.abs(lag)]
    pooled = np.concatenate(error)
    flat = {name: np.concatenate(arrays) for name, arrays in tests.items()}
    return ResidualTests(
        step_s=float(step_s),
        count=int(size.sum()),
        mean=mean,
        deviation=deviation,
        **_whiteness(of_errors, pairs, max_lag),
        **_independence(cross, lag, of_errors, of_command, pairs),
        **_normality(pooled, of_errors, pairs, is_constant=not deviation),
        by_position=_binned(flat["errors"], pooled, flat["displacements"]),
        by_speed=_binned(flat["errors"], pooled, flat["speeds"]),
        by_command=_binned(flat["errors"], pooled, flat["commands"]),
    )


def _whiteness(autocorrelation: np.ndarray, pairs: np.ndarray, max_lag: int) -> dict[str, Any]:
    """Return the fields of Ljung and Box's test.

    Q = (N + 2)/N Σ_k N_k r_k² ~ χ²_h, for one test N (N + 2) Σ_k ρ̂_k² / (N − k), ρ̂_k = r_k (N − k)/N
    (Ljung & Box 1978, Biometrika 65, 297).
    """
    count = int(pairs[0])
    auto = autocorrelation[1 : max_lag + 1]
    whiteness = float((count + 2) / count * np.sum(pairs[1 : max_lag + 1] * auto**2))
    whiteness_p = float(chdtrc(max_lag, whiteness)) if max_lag else 1.0
    return {
        "whiteness": whiteness,
        "freedom": max_lag,
        "whiteness_p": whiteness_p,
        "white": whiteness_p >= LEVEL,
        "autocorrelation": tuple(auto.tolist()),
        "autocorrelation_bounds": tuple((BOUND / np.sqrt(pairs[1 : max_lag + 1])).tolist()),
    }


def _independence(
    cross: np.ndarray,
    lag: np.ndarray,
    error_autocorrelation: np.ndarray,
    command_autocorrelation: np.ndarray,
    pairs: np.ndarray,
) -> dict[str, Any]:
    """Return the fields of the cross-correlation at lags −h..h, held against that of independent signals.

    At lag k its variance is Σ_j N_{|k|+|j|} w_j r_e(j) r_u(j) / N_k², or 1/N_k where that is more (Bartlett
    1946, J. R. Stat. Soc. Suppl. 8, 27); see `_taper` for w_j.
    """
    product = _taper(error_autocorrelation, pairs) * error_autocorrelation * command_autocorrelation
    product[1:] *= 2.0
    lag_pairs = pairs[: lag[-1] + 1]
    total = [np.sum(pairs[k:] * product[: pairs.size - k]) for k in range(lag_pairs.size)]
    spread = (np.sqrt(np.maximum(np.array(total), lag_pairs)) / lag_pairs)[np.abs(lag)]
    independence_p = min(1.0, float(lag.size * 2 * ndtr(-np.max(np.abs(cross) / spread))))
    return {
        "cross_lags": tuple(lag.tolist()),
        "cross_correlation": tuple(cross.tolist()),
        "cross_bounds": tuple((BOUND * spread).tolist()),
        "lags_outside": tuple(lag[np.abs(cross) > BOUND * spread].tolist()),
        "independence_p": independence_p,
        "independent": independence_p >= LEVEL,
    }


def _normality(
    pooled: np.ndarray, error_autocorrelation: np.ndarray, pairs: np.ndarray, *, is_constant: bool
) -> dict[str, Any]:
    """Return the fields of Jarque and Bera's test for autocorrelated errors.

    N s² / (6 F₃) + N κ² / (24 F₄) ~ χ²_2 for skewness s and excess kurtosis κ, F_p = Σ_j N_j/N r_e(j)^p over
    all lags of either sign, F₃ at least 1 (Lobato & Velasco 2004, Econometric Theory 20, 671).
    """
    skewness = float(np.mean(pooled**3))
    kurtosis = 0.0 if is_constant else float(np.mean(pooled**4)) - 3.0
    count = int(pairs[0])
    third, fourth = (
        1.0 + 2.0 * float(np.sum(pairs[1:] / count * error_autocorrelation[1:] ** p)) for p in (3, 4)
    )
    statistic = count * (skewness**2 / (6 * max(third, 1.0)) + kurtosis**2 / (24 * fourth))
    p_value = float(chdtrc(2, statistic))
    return {
        "skewness": skewness,
        "excess_kurtosis": kurtosis,
        "normality_p": p_value,
        "normal": p_value >= LEVEL,
    }


def _standardised(tests: Sequence[np.ndarray]) -> tuple[list[np.ndarray], float, float]:
    """Return the tests with pooled mean 0 and mean square 1, or 0 where constant; mean and deviation."""
    pooled = np.concatenate(tests)
    if np.all(pooled == pooled[0]):
        return [np.zeros(test.size) for test in tests], float(pooled[0]), 0.0
    # Squares of very large or small values would overflow or vanish.
    scale = float(np.max(np.abs(pooled)))
    mean = float(np.mean(pooled / scale))
    deviation = float(np.std(pooled / scale))
    return [(test / scale - mean) / deviation for test in tests], scale * mean, scale * deviation


def _products(first_signals: Sequence[np.ndarray], second_signals: Sequence[np.ndarray]) -> np.ndarray:
    """Return Σ a(t + k) b(t) over all tests, products within a test, k = −L..L for length L + 1."""
    from scipy.signal import correlate  # not at the top: half a second

    longest = max(test.size for test in first_signals)
    total = np.zeros(2 * longest - 1)
    for first, second in zip(first_signals, second_signals, strict=True):
        total[longest - first.size : longest + first.size - 1] += correlate(first, second)
    return total


def _taper(correlation: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return weights of lags 0..L, positive where the errors' autocorrelation is significant, shape [L + 1].

    The weight is 1 up to the lag m after which five lags on end lie within 2 √(log₁₀ N / N_k), and falls to 0
    at 2m (Politis 2003, J. Nonparametr. Stat. 15, 517). Only the errors set m: the command is given, not
    random. Over all lags the sum would equal that of the squared cross-correlations, and the dependence under
    test would widen the bounds.
    """
    significant = np.abs(correlation) >= 2.0 * np.sqrt(np.log10(pairs[0]) / pairs)
    significant[0] = True
    lag = np.arange(significant.size)
    last = np.maximum.accumulate(np.where(significant, lag, 0))
    ends = np.flatnonzero(lag - last >= 5)
    cutoff_lag = int(last[ends[0]] if ends.size else last[-1])
    return np.clip(2.0 - lag / max(cutoff_lag, 0.5), 0.0, 1.0)


def _binned(errors: np.ndarray, standardised: np.ndarray, values: np.ndarray) -> Binned:
    """Bin errors, shape [N], by a quantity: one bin per value, or at more than 8 values, by octiles."""
    upper_edges = np.unique(values)
    if upper_edges.size > MAX_BINS:
        # Edges are values of the data, so that equal values share a bin.
        share = np.arange(1, MAX_BINS + 1) / MAX_BINS
        upper_edges = np.unique(np.quantile(values, share, method="inverted_cdf"))
    bin_index = np.searchsorted(upper_edges, values)
    scale = float(np.max(np.abs(errors))) or 1.0
    bins, explained = [], 0.0
    for number in range(upper_edges.size):
        inside = bin_index == number
        scaled_errors = errors[inside] / scale
        explained += scaled_errors.size * float(np.mean(standardised[inside])) ** 2
        bins.append(
            Bin(
                lower=float(np.min(values[inside])),
                upper=float(upper_edges[number]),
                count=int(scaled_errors.size),
                mean=scale * float(np.mean(scaled_errors)),
                rmse=scale * float(np.sqrt(np.mean(scaled_errors**2))),
            )
        )
    return Binned(share=min(1.0, explained / errors.size), bins=tuple(bins))
