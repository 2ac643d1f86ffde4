"""Autoregressive models of travel: free run and multi-step prediction."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hitchid.baselines.fitted import FittedBaseline
from hitchid.structures import Batch


class Autoregression(FittedBaseline):
    """A model of travel w (displacement relative to the start) from past samples of w and of inputs."""

    @property
    @abstractmethod
    def lag(self) -> int:
        """Largest lag n, in samples."""

    @abstractmethod
    def inputs(self, batch: Batch) -> np.ndarray:
        """Return the inputs of tests, shape [T, m, N]."""

    @abstractmethod
    def predict_next(self, inputs: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n), shape [m, n, N], and w(k−1) … w(k−n), shape [n, N]."""

    @abstractmethod
    def simulate(self, inputs: np.ndarray) -> np.ndarray:
        """Return travel simulated from inputs of shape [m, N] alone, from rest, shape [N]."""

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        return to_displacement(batch, np.array([self.simulate(inputs) for inputs in self.inputs(batch)]))

    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]]:
        """Return the h-step-ahead predictions of displacement, for each h, shape [T, N] each."""
        travels = batch.sign * (np.asarray(batch.displacement) - np.asarray(batch.initial)[:, None])
        rows = [
            predict_ahead(self, inputs, travel, horizons)
            for inputs, travel in zip(self.inputs(batch), travels, strict=True)
        ]
        return [to_displacement(batch, travel) for travel in np.swapaxes(rows, 0, 1)]


def predict_ahead(
    model: Autoregression, inputs: np.ndarray, travel: np.ndarray, horizons: Sequence[int]
) -> np.ndarray:
    """Return h-step-ahead predictions of travel, zero for the first h samples.

    Args:
        model: an autoregressive model; it is iterated from all samples at once.
        inputs: of one test that starts from rest, shape [m, N].
        travel: its measured travel, shape [N].
        horizons: prediction horizons h, in samples.

    Returns:
        Predictions, shape [len(horizons), N].
    """
    lag, count, farthest = model.lag, travel.size, max(horizons)
    past = np.concatenate([np.zeros(lag), travel])
    padded = np.pad(inputs, ((0, 0), (lag, farthest)))
    history = [past[lag - i : lag - i + count] for i in range(lag)]
    predictions = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(1, farthest + 1):
            lagged = [padded[:, lag + step - i : lag + step - i + count] for i in range(1, lag + 1)]
            history = [
                model.predict_next(np.stack(lagged, axis=1), np.stack(history)),
                *history[: lag - 1],
            ]
            predictions[step] = history[0]
    return np.stack([np.concatenate([np.zeros(h), predictions[h][: count - h]]) for h in horizons])


def to_displacement(batch: Batch, travel: np.ndarray) -> np.ndarray:
    """Return the displacement that belongs to a travel, shape [T, N]."""
    return np.asarray(batch.initial)[:, None] + batch.sign * travel
