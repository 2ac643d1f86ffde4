"""Linear autoregression with inputs (ARX)."""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
from jaxtyping import Float

from hitchid.baselines.autoregression import Autoregression
from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.baselines.linear_inputs import (
    LinearInputs,
    UnpaddedTest,
    free_run_error,
    unpadded_tests,
)
from hitchid.structures import Batch, split_validation

ORDERS = (1, 2, 3, 5, 8, 12, 20)  # orders n that are compared, in samples; 20 are 0.2 s at 100 Hz; chosen


class Arx(Autoregression):
    """ARX model of travel w (displacement relative to the start).

    w(k) = Σ aᵢ w(k−i) + Σⱼ Σ bⱼᵢ uⱼ(k−i), i = 1 … n.

    Attributes:
        scaling: the inputs u.
        past: coefficients a of past travel, shape [n].
        gains: coefficients b of past inputs, shape [m, n].
    """

    scaling: LinearInputs
    past: np.ndarray
    gains: np.ndarray

    @classmethod
    def fit(cls, scaling: LinearInputs, tests: Sequence[UnpaddedTest], order: int) -> "Arx":
        """Fit by least squares one step ahead to tests that start from rest."""
        return _solved(scaling, _triangular_factor(tests, order), order, order, len(tests[0].inputs))

    @property
    def lag(self) -> int:
        """Largest lag n, in samples."""
        return self.past.size

    def inputs(self, batch: Batch) -> np.ndarray:
        """Return the inputs of tests, shape [T, m, N]."""
        return self.scaling.rows(batch, len(self.gains))

    def predict_next(self, inputs: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n), shape [m, n, N], and w(k−1) … w(k−n), shape [n, N]."""
        return np.einsum("mn,mnk->k", self.gains, inputs) + self.past @ travel

    def simulate(self, inputs: np.ndarray) -> np.ndarray:
        """Return travel simulated from inputs of shape [m, N] alone, from rest, shape [N]."""
        from scipy.signal import lfilter  # imported here: the import takes half a second

        driven = [
            np.asarray(lfilter(np.append(0.0, gains), [1.0], row))
            for gains, row in zip(self.gains, inputs, strict=True)
        ]
        return np.asarray(lfilter([1.0], np.append(1.0, -self.past), np.sum(driven, axis=0)))


class ArxBaseline(Baseline):
    """ARX with the order and inputs of the smallest error in free run on the validation tests."""

    name, title, quick = "arx", "ARX", True

    def fit(self, tests: Batch, context: FitContext) -> Arx:
        """Return the ARX model: order and inputs by free run, coefficients one step ahead on all tests."""
        scaling = LinearInputs.of(tests)
        training, validation, _ = split_validation(tests)
        largest = max(scaling.counts)

        def error(model: Arx) -> float:
            validation_tests = unpadded_tests(validation, model.inputs(validation))
            return free_run_error(
                [model.simulate(test.inputs) for test in validation_tests], validation_tests
            )

        def factor(batch: Batch) -> Float[np.ndarray, "r c"]:
            return _triangular_factor(unpadded_tests(batch, scaling.rows(batch, largest)), max(ORDERS))

        of_training = factor(training)
        models = [
            _solved(scaling, of_training, max(ORDERS), *choice) for choice in product(ORDERS, scaling.counts)
        ]
        best = min(models, key=error)
        return _solved(scaling, factor(tests), max(ORDERS), best.lag, len(best.gains))

    def skeleton(self, shapes: Sizes) -> Arx:
        """Return a model of the stored order, all coefficients zero."""
        return Arx(
            LinearInputs.unfilled(*shapes["scaling/load_centre"]),
            np.zeros(shapes["past"]),
            np.zeros(shapes["gains"]),
        )


def _triangular_factor(tests: Iterable[UnpaddedTest], max_order: int) -> Float[np.ndarray, "r c"]:
    """Return R of the QR factors of all equations with their right side as last column.

    Least squares of every smaller order and number of inputs are those of some of its columns: the tests are
    read once for all of them. Columns are lags 1 … n of travel, then of each input.
    """
    factor = np.zeros((0, 0))
    for test in tests:
        rows = np.column_stack([_lagged(test, max_order), test.travel])[test.loss_mask]
        factor = np.asarray(np.linalg.qr(np.vstack([factor, rows]) if factor.size else rows, mode="r"))
    return factor


def _solved(
    scaling: LinearInputs, factor: Float[np.ndarray, "r c"], max_order: int, order: int, inputs: int
) -> Arx:
    """Return the ARX model of an order with the first inputs, fitted one step ahead."""
    first_lags = max_order * np.arange(1 + inputs)[:, None] + np.arange(order)
    solution = np.linalg.lstsq(factor[:, first_lags.ravel()], factor[:, -1], rcond=None)[0]
    return Arx(scaling, solution[:order], solution[order:].reshape(-1, order))


def _lagged(test: UnpaddedTest, order: int) -> np.ndarray:
    """Return rows [w(k−1) … w(k−n), u₁(k−1) … u₁(k−n), …], zero before the test, shape [N, (m + 1) n]."""

    def lags(samples: np.ndarray) -> np.ndarray:
        padded = np.concatenate([np.zeros(order), samples[:-1]])
        return np.lib.stride_tricks.sliding_window_view(padded, order)[:, ::-1]

    return np.hstack([lags(row) for row in (test.travel, *test.inputs)])
