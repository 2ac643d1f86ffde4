"""Linear autoregression with input (ARX)."""

from collections.abc import Sequence

import numpy as np

from hitchid.baselines.autoregression import Autoregression, Test, unpadded_tests
from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.structures import Batch

ORDERS = (1, 2, 3, 5, 8, 12, 20)  # orders n that are compared, in samples; 20 are 0.2 s at 100 Hz; chosen


class Arx(Autoregression):
    """ARX model of travel w (displacement relative to the start).

    w(k) = Σ aᵢ w(k−i) + Σ bᵢ u(k−i), i = 1 … n.

    Attributes:
        past: coefficients a of past travel, shape [n].
        command: coefficients b of the past command, shape [n].
    """

    past: np.ndarray
    command: np.ndarray

    @classmethod
    def fit(cls, tests: Sequence[Test], order: int) -> "Arx":
        """Fit by least squares to tests that start from rest; see `Test`."""
        rows = np.concatenate(
            [_lagged(travel, command, order)[loss_mask] for command, travel, loss_mask in tests]
        )
        target = np.concatenate([travel[loss_mask] for _, travel, loss_mask in tests])
        solution = np.linalg.lstsq(rows, target, rcond=None)[0]
        return cls(solution[:order], solution[order:])

    @property
    def lag(self) -> int:
        """Largest lag n, in samples."""
        return self.past.size

    def predict_next(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n) and w(k−1) … w(k−n), shape [n, N] each."""
        return self.command @ command + self.past @ travel

    def one_step(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return the one-step-ahead prediction of travel from measured travel, shape [N]."""
        return _lagged(travel, command, self.past.size) @ np.concatenate([self.past, self.command])

    def simulate(self, command: np.ndarray) -> np.ndarray:
        """Return travel simulated from the command alone, shape [N]."""
        from scipy.signal import lfilter  # imported here: the import takes half a second

        return np.asarray(lfilter(np.append(0.0, self.command), np.append(1.0, -self.past), command))


class ArxBaseline(Baseline):
    """ARX with the order of the smallest one-step-ahead error on the validation tests."""

    name, title = "arx", "ARX"

    def fit(self, training: Batch, validation: Batch, context: FitContext) -> Arx:
        """Return the ARX model with the smallest one-step-ahead error on the validation tests."""
        tests, validation_tests = unpadded_tests(training), unpadded_tests(validation)

        def squared_error(model: Arx) -> float:
            return sum(
                float(np.sum((model.one_step(command, travel) - travel)[loss_mask] ** 2))
                for command, travel, loss_mask in validation_tests
            )

        return min((Arx.fit(tests, order) for order in ORDERS), key=squared_error)

    def skeleton(self, shapes: Sizes) -> Arx:
        """Return a model of the stored order, all coefficients zero."""
        return Arx(np.zeros(shapes["past"]), np.zeros(shapes["command"]))


def _lagged(travel: np.ndarray, command: np.ndarray, order: int) -> np.ndarray:
    """Return rows [w(k−1) … w(k−n), u(k−1) … u(k−n)], zero before the test, shape [N, 2 n]."""

    def lags(samples: np.ndarray) -> np.ndarray:
        padded = np.concatenate([np.zeros(order), samples[:-1]])
        return np.lib.stride_tricks.sliding_window_view(padded, order)[:, ::-1]

    return np.hstack([lags(travel), lags(command)])
