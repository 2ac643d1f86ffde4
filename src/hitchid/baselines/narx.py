"""Polynomial autoregression with input (NARX), fitted by forward regression (FROLS of sysidentpy)."""

from collections.abc import Iterator
from math import prod
from typing import Any, NamedTuple

import numpy as np

from hitchid.baselines.autoregression import Autoregression, unpadded_tests
from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.structures import Batch

DEGREE = 2  # factors of a term
LAGS = (1, 2, 3, 5, 8)  # samples, tried in turn
TERMS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 30)  # number of terms, tried in turn
# Samples, from the time of a fit: rows of the regression; a validation section; all validation sections.
MAX_ROWS, SECTION_SAMPLES, MAX_VALIDATION_SAMPLES = 20_000, 10_000, 40_000


class Narx(Autoregression):
    """Polynomial autoregression with input on travel w (displacement away from the start).

    w(k) = Σₘ θₘ fₘ₁(k) fₘ₂(k) …, each factor f one of 1, w(k−i), u(k−i), i ≥ 1; w and u in their scales.

    Attributes:
        terms: factors of each term, shape [M, degree]: 0 stands for 1, i for w(k−i), −i for u(k−i).
        coefficients: θ, of scaled travel and command, shape [M].
        travel_scale, command_scale: what travel and command are divided by, shape [].
    """

    terms: np.ndarray
    coefficients: np.ndarray
    travel_scale: np.ndarray
    command_scale: np.ndarray

    @property
    def lag(self) -> int:
        """The longest lag i of any factor, at least 1."""
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
        """Return travel predicted from measured travel up to the sample before, from rest, shape [N]."""
        history = _prepend_zeros(travel / self.travel_scale, self.lag)
        first, count = self.lag, command.size
        predicted = sum(
            gain * prod((history[first - i : first - i + count] for i in lags), start=np.ones(count))
            for lags, gain in self._gains(_prepend_zeros(command, first), count).items()
        )
        return self.travel_scale * (np.zeros(count) + predicted)

    def simulate(self, command: np.ndarray) -> np.ndarray:
        """Return travel simulated from the command alone, from rest, shape [N].

        What diverges becomes infinite or not a number, without a warning.
        """
        return self.simulate_from(_prepend_zeros(command, self.lag), np.zeros(self.lag))

    def simulate_from(self, command: np.ndarray, past: np.ndarray) -> np.ndarray:
        """Return travel simulated on from a measured past, shape [N]; see `simulate`.

        Args:
            command: of the past and of what is simulated, shape [P + N].
            past: measured travel, P ≥ `lag` samples, shape [P].
        """
        count = command.size - past.size
        gains = self._gains(command, count)
        products = tuple(gains)
        history = (past / self.travel_scale).tolist()
        # Plain floats: for a few terms much faster than arrays, and they overflow in silence.
        for row in np.reshape(list(gains.values()), (len(products), count)).T.tolist():
            total = 0.0
            for gain, lags in zip(row, products, strict=True):
                for i in lags:
                    gain *= history[-i]
                total += gain
            history.append(total)
        return self.travel_scale * np.array(history[past.size :])

    def _gains(self, command: np.ndarray, count: int) -> dict[tuple[int, ...], np.ndarray]:
        """Return by which each product of past travels is multiplied in the last samples, shape [count].

        A product is named by its lags; terms without past travel stand under ().
        """
        scaled, first = command / self.command_scale, command.size - count
        gains: dict[tuple[int, ...], np.ndarray] = {}
        for factors, coefficient in zip(self.terms.tolist(), self.coefficients, strict=True):
            commands = (scaled[first + i : first + i + count] for i in factors if i < 0)
            lags = tuple(sorted(i for i in factors if i > 0))
            gains[lags] = gains.get(lags, 0.0) + prod(commands, start=np.full(count, coefficient))
        return gains


class NarxBaseline(Baseline):
    """Polynomial NARX by forward regression (FROLS of sysidentpy), where that is installed."""

    name, title = "narx", "NARX"

    def fit(self, training: Batch, validation: Batch, context: FitContext) -> Narx | None:
        """Return the NARX model whose lags and number of terms predict the validation tests best in free run.

        For each number of lags, candidates are all products of up to two of 1, w(k−i), u(k−i), in the order
        of their error reduction ratio; coefficients by least squares. Each test has its own rows, from rest;
        all rows are fitted together, of more than 20 000 every m-th. Validation tests longer than 10 000
        samples are cut, each section starting from its measured past; of more than 40 000 samples every m-th
        section is compared.

        Args:
            training, validation: the tests of the compensator.
            context: not used; the fit is deterministic.

        Returns:
            The model; None where sysidentpy is not installed, or no sample of training counts.

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
        """Return a model of the stored number of terms."""
        terms = np.zeros(shapes["terms"], dtype=np.int64)
        return Narx(terms, np.zeros(shapes["coefficients"]), np.zeros(()), np.zeros(()))


class _TestSegment(NamedTuple):
    """Part of a test, with its past in front.

    Attributes:
        command, travel: of the past and the part, shape [P + N]; the past of a test is rest.
        loss_mask: which samples of the part count, shape [N].
    """

    command: np.ndarray
    travel: np.ndarray
    loss_mask: np.ndarray


def _candidates(
    segments: list[_TestSegment], lags: int, scales: tuple[np.ndarray, np.ndarray]
) -> Iterator[Narx]:
    """Yield models of one number of lags, from few to many terms."""
    from sysidentpy.basis_function import Polynomial  # pyright: ignore[reportMissingImports]
    from sysidentpy.model_structure_selection import FROLS  # pyright: ignore[reportMissingImports]

    method = FROLS(xlag=lags, ylag=lags, basis_function=Polynomial(degree=DEGREE))
    rows, target = _regression(segments, lags, scales, method)
    terms = _terms(method.regressor_space(1))
    max_terms = min(TERMS[-1], terms.shape[0], target.size - 1)
    with np.errstate(all="ignore"):  # columns that depend on each other leave nothing to divide by
        # The method leaves out as many targets as there are lags; rows here need none.
        _, order, _ = method.error_reduction_ratio(rows, np.pad(target, (lags, 0))[:, None], max_terms)
    for size in dict.fromkeys(min(size, max_terms) for size in TERMS):
        selected_terms = order[:size]
        coefficients = np.linalg.lstsq(rows[:, selected_terms], target, rcond=None)[0]
        yield Narx(terms[selected_terms], coefficients, *scales)


def _regression(
    segments: list[_TestSegment], lags: int, scales: tuple[np.ndarray, np.ndarray], method: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return every candidate term at every sample that counts, shape [K, C], and its travel, shape [K].

    Rows whose smallest lagged value is largest come first: the Householder reflections of sysidentpy 0.9 go
    wrong where the first entry of a column is exactly zero, as commands are at rest.
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
    """Return sysidentpy's codes (1000 + i for w(k−i), 2000 + i for u(k−i)) as `Narx` has them."""
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
    """Return the parts of all tests that have samples that count, each with the longest past in front."""
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
    """Return every m-th section, so that no more than 40 000 samples are left."""
    return segments[
        :: max(1, -(-sum(segment.loss_mask.size for segment in segments) // MAX_VALIDATION_SAMPLES))
    ]


def _scale(samples: list[np.ndarray]) -> np.ndarray:
    """Return the largest value of all, shape []."""
    return np.array(max(float(np.abs(array).max()) for array in samples) or 1.0)


def _prepend_zeros(samples: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([np.zeros(count), samples])
