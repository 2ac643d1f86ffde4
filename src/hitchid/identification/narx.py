"""Fits a polynomial NARX by forward regression (FROLS of sysidentpy), where that is installed."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from hitchid.baselines.narx import Narx
from hitchid.structures import Batch

DEGREE = 2
LAGS = (1, 2, 3, 5, 8)
TERMS = (2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 30)
MAX_ROWS = 20_000
SECTION_SAMPLES = 10_000
MAX_VALIDATION_SAMPLES = 40_000


class _TestSegment(NamedTuple):
    """Part of a test, with its past in front.

    Attributes:
        command, travel: of the past and the part, shape [P + N]; the past of a test is rest.
        loss_mask: which samples of the part count, shape [N].
    """

    command: np.ndarray
    travel: np.ndarray
    loss_mask: np.ndarray


def fit_narx(training: Batch, validation: Batch) -> Narx | None:
    """Return the NARX model whose lags and number of terms predict the validation tests best in free run.

    For each number of lags, candidates are all products of up to two of 1, w(k−i) and u(k−i), taken up in
    the order of their error reduction ratio; coefficients by least squares. Each test has its own rows, from
    rest; all rows are fitted together. Of more than 20 000 rows every m-th is fitted. Validation tests longer
    than 10 000 samples are cut, each section going on from its measured past; of more than 40 000 samples
    every m-th section is compared.

    Args:
        training, validation: the tests the compensator has too.

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
    for command, travel, loss_mask, valid in zip(
        batch.command, batch.travel, batch.loss_mask, np.asarray(batch.valid), strict=True
    ):
        command, travel, loss_mask = (np.asarray(array)[valid] for array in (command, travel, loss_mask))
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
