"""Polynomial autoregression with input (NARX), fitted by forward regression (FROLS of sysidentpy)."""

from collections.abc import Iterator
from math import prod
from typing import Any, NamedTuple

import numpy as np

from hitchid.baselines.autoregression import Autoregression, unpadded_tests
from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.structures import Batch

DEGREE = 2  # largest degree of a term; chosen
LAGS = (1, 2, 3, 5, 8)  # largest lags that are compared, in samples; chosen
TERMS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 30)  # numbers of terms that are compared; chosen
# Samples, chosen to bound the time of a fit: rows of the regression, one validation section, all of them.
MAX_ROWS, SECTION_SAMPLES, MAX_VALIDATION_SAMPLES = 20_000, 10_000, 40_000


class Narx(Autoregression):
    """Polynomial NARX model of travel w (displacement relative to the start).

    w(k) = Σₘ θₘ fₘ₁(k) fₘ₂(k) …, each factor f one of 1, w(k−i), u(k−i), i ≥ 1; w and u scaled.

    Attributes:
        terms: factors of each term, shape [M, degree]: 0 is the constant 1, i is w(k−i), −i is u(k−i).
        coefficients: θ, for scaled travel and command, shape [M].
        travel_scale, command_scale: divisors of travel and command, shape [].
    """

    terms: np.ndarray
    coefficients: np.ndarray
    travel_scale: np.ndarray
    command_scale: np.ndarray

    @property
    def lag(self) -> int:
        """Largest lag i of any factor, in samples, at least 1."""
        return int(np.abs(self.terms).max(initial=1))

    def predict_next(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n) and w(k−1) … w(k−n), shape [n, N] each."""
        scaled = {0: np.ones(command.shape[1])}
        scaled |= {i: row / self.travel_scale for i, row in enumerate(travel, start=1)}
        scaled |= {-i: row / self.command_scale for i, row in enumerate(command, start=1)}
        terms = zip(self.terms.tolist(), self.coefficients, strict=True)
        total = sum(gain * prod((scaled[i] for i in factors), start=scaled[0]) for factors, gain in terms)
        return self.travel_scale * (total + 0.0 * scaled[0])

    def one_step(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return the one-step-ahead prediction of travel of a test from rest, shape [N]."""
        history = _prepend_zeros(travel / self.travel_scale, self.lag)
        first, count = self.lag, command.size
        predicted = sum(
            gain * prod((history[first - i : first - i + count] for i in lags), start=np.ones(count))
            for lags, gain in self._gains(_prepend_zeros(command, first), count).items()
        )
        return self.travel_scale * (np.zeros(count) + predicted)

    def simulate(self, command: np.ndarray) -> np.ndarray:
        """Return travel simulated from the command alone, from rest, shape [N].

        A simulation that diverges becomes infinite or NaN, without a warning.
        """
        return self.simulate_from(_prepend_zeros(command, self.lag), np.zeros(self.lag))

    def simulate_from(self, command: np.ndarray, past: np.ndarray) -> np.ndarray:
        """Return travel simulated from a measured past, shape [N]; see `simulate`.

        Args:
            command: command of the past and of the simulated samples, shape [P + N].
            past: measured travel, P ≥ `lag` samples, shape [P].
        """
        count = command.size - past.size
        gains = self._gains(command, count)
        products = tuple(gains)
        history = (past / self.travel_scale).tolist()
        # Python floats: for a few terms much faster than arrays, and without overflow warnings.
        for row in np.reshape(list(gains.values()), (len(products), count)).T.tolist():
            total = 0.0
            for gain, lags in zip(row, products, strict=True):
                for i in lags:
                    gain *= history[-i]
                total += gain
            history.append(total)
        return self.travel_scale * np.array(history[past.size :])

    def _gains(self, command: np.ndarray, count: int) -> dict[tuple[int, ...], np.ndarray]:
        """Return the factor of each product of past travels at the last `count` samples, shape [count].

        The key is the lags of a product, () for terms without past travel.
        """
        scaled, first = command / self.command_scale, command.size - count
        gains: dict[tuple[int, ...], np.ndarray] = {}
        for factors, coefficient in zip(self.terms.tolist(), self.coefficients, strict=True):
            commands = (scaled[first + i : first + i + count] for i in factors if i < 0)
            lags = tuple(sorted(i for i in factors if i > 0))
            gains[lags] = gains.get(lags, 0.0) + prod(commands, start=np.full(count, coefficient))
        return gains


class NarxBaseline(Baseline):
    """Polynomial NARX by forward regression (FROLS of sysidentpy, an optional dependency)."""

    name, title = "narx", "NARX"

    def fit(self, training: Batch, validation: Batch, context: FitContext) -> Narx | None:
        """Return the NARX model with the smallest free-run error on the validation tests.

        Lags and number of terms are varied. Candidate terms are all products of up to two of 1, w(k−i),
        u(k−i), ordered by error reduction ratio; coefficients by least squares. All tests, each from rest,
        are fitted together; of more than 20 000 rows every m-th is used. Validation tests longer than 10 000
        samples are cut into sections, each starting from its measured past; of more than 40 000 samples every
        m-th section is used.

        Args:
            training, validation: the tests of the compensator.
            context: not used; the fit is deterministic.

        Returns:
            The model; None where sysidentpy is not installed or the loss mask of all training tests is empty.

        Source: Billings, Nonlinear System Identification (2013), chapter 3; sysidentpy 0.9.
        """
        try:
            import sysidentpy.model_structure_selection  # noqa: F401  # pyright: ignore[reportMissingImports]
        except ImportError:
            return None
        training_segments = _segments(training, longest=None)
        if not training_segments:
            return None
        validation_segments = _decimate(_segments(validation, longest=SECTION_SAMPLES))
        scales = (
            _scale([segment.travel for segment in training_segments]),
            _scale([segment.command for segment in training_segments]),
        )
        models = (model for lags in LAGS for model in _candidates(training_segments, lags, scales))
        return min(models, key=lambda model: _squared_error(model, validation_segments))

    def skeleton(self, shapes: Sizes) -> Narx:
        """Return a model of the stored number of terms, all arrays zero."""
        terms = np.zeros(shapes["terms"], dtype=np.int64)
        return Narx(terms, np.zeros(shapes["coefficients"]), np.zeros(()), np.zeros(()))


class _TestSegment(NamedTuple):
    """Section of a test, preceded by its past.

    Attributes:
        command, travel: signals of the past and the section, shape [P + N]; before a test all zero.
        loss_mask: samples of the section that errors are taken over, shape [N].
    """

    command: np.ndarray
    travel: np.ndarray
    loss_mask: np.ndarray


def _candidates(
    segments: list[_TestSegment], lags: int, scales: tuple[np.ndarray, np.ndarray]
) -> Iterator[Narx]:
    """Yield the models of one largest lag, from few to many terms."""
    from sysidentpy.basis_function import Polynomial  # pyright: ignore[reportMissingImports]
    from sysidentpy.model_structure_selection import FROLS  # pyright: ignore[reportMissingImports]

    method = FROLS(xlag=lags, ylag=lags, basis_function=Polynomial(degree=DEGREE))
    rows, target = _regression(segments, lags, scales, method)
    terms = _terms(method.regressor_space(1))
    max_terms = min(TERMS[-1], terms.shape[0], target.size - 1)
    with np.errstate(all="ignore"):  # linearly dependent columns give a division by zero
        # FROLS drops as many targets as there are lags; the padding keeps all targets of these rows.
        _, order, _ = method.error_reduction_ratio(rows, np.pad(target, (lags, 0))[:, None], max_terms)
    for size in dict.fromkeys(min(size, max_terms) for size in TERMS):
        selected_terms = order[:size]
        coefficients = np.linalg.lstsq(rows[:, selected_terms], target, rcond=None)[0]
        yield Narx(terms[selected_terms], coefficients, *scales)


def _regression(
    segments: list[_TestSegment], lags: int, scales: tuple[np.ndarray, np.ndarray], method: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return candidate terms at all samples of the loss mask, shape [K, C], and their travel, shape [K].

    Rows are sorted by their smallest lagged value, largest first: the Householder reflections of sysidentpy
    0.9 fail where the first entry of a column is exactly zero, as commands are at rest.
    """
    from sysidentpy.utils.information_matrix import (  # pyright: ignore[reportMissingImports]
        build_lagged_matrix,
    )

    stride = -(-sum(int(segment.loss_mask.sum()) for segment in segments) // MAX_ROWS)
    travel_scale, command_scale = scales
    lagged, target = [], []
    for command, travel, loss_mask in segments:
        past = travel.size - loss_mask.size - lags
        outputs, inputs = travel[past:] / travel_scale, command[past:] / command_scale
        selected_rows = np.flatnonzero(loss_mask)[::stride]
        matrix = build_lagged_matrix(inputs[:, None], outputs[:, None], lags, lags, method.model_type)
        lagged.append(matrix[lags:][selected_rows])
        target.append(outputs[lags:][selected_rows])
    stacked = np.concatenate(lagged)
    order = np.argsort(-np.abs(stacked).min(axis=1), kind="stable")
    return method.basis_function.fit(stacked[order], max_lag=0), np.concatenate(target)[order]


def _terms(codes: np.ndarray) -> np.ndarray:
    """Convert sysidentpy's codes (1000 + i for w(k−i), 2000 + i for u(k−i)) to those of `Narx`."""
    return np.where(codes > 2000, 2000 - codes, np.where(codes > 1000, codes - 1000, 0)).astype(np.int64)


def _squared_error(model: Narx, segments: list[_TestSegment]) -> float:
    """Return the sum of squared errors in free run, infinite for a model that diverges."""
    squared_error = 0.0
    with np.errstate(all="ignore"):
        for command, travel, loss_mask in segments:
            past = travel.size - loss_mask.size
            errors = model.simulate_from(command, travel[:past]) - travel[past:]
            squared_error += float(np.sum(errors[loss_mask] ** 2))
    return squared_error if np.isfinite(squared_error) else np.inf


def _segments(batch: Batch, *, longest: int | None) -> list[_TestSegment]:
    """Return the sections of all tests with a non-empty loss mask, each preceded by the longest past."""
    segments = []
    max_lag = LAGS[-1]
    for command, travel, loss_mask in unpadded_tests(batch):
        command, travel = np.pad(command, (max_lag, 0)), np.pad(travel, (max_lag, 0))
        width = longest or loss_mask.size
        for first in range(0, loss_mask.size, width):
            samples = slice(first, first + width + max_lag)
            segments.append(_TestSegment(command[samples], travel[samples], loss_mask[first : first + width]))
    return [segment for segment in segments if segment.loss_mask.any()]


def _decimate(segments: list[_TestSegment]) -> list[_TestSegment]:
    """Return every m-th section, so that at most about 40 000 samples remain."""
    return segments[
        :: max(1, -(-sum(segment.loss_mask.size for segment in segments) // MAX_VALIDATION_SAMPLES))
    ]


def _scale(samples: list[np.ndarray]) -> np.ndarray:
    """Return the largest absolute value, 1 where all are zero, shape []."""
    return np.array(max(float(np.abs(array).max()) for array in samples) or 1.0)


def _prepend_zeros(samples: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([np.zeros(count), samples])
