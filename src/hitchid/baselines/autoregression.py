"""Autoregressive models of travel: free run and multi-step prediction."""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hitchid.baselines.fitted import FittedBaseline
from hitchid.structures import Batch

# One test from rest: command, travel and loss mask, each of shape [N].
Test = tuple[np.ndarray, np.ndarray, np.ndarray]


class Autoregression(FittedBaseline):
    """A model of travel w (displacement relative to the start) from past samples of w and of the command."""

    @property
    @abstractmethod
    def lag(self) -> int:
        """Largest lag n, in samples."""

    @abstractmethod
    def predict_next(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n) and w(k−1) … w(k−n), shape [n, N] each."""

    @abstractmethod
    def simulate(self, command: np.ndarray) -> np.ndarray:
        """Return travel simulated from the command alone, from rest, shape [N]."""

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        return _displacement(
            batch, np.array([self.simulate(command) for command in np.asarray(batch.command)])
        )

    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]]:
        """Return the h-step-ahead predictions of displacement, for each h, shape [T, N] each."""
        travels = batch.sign * (np.asarray(batch.displacement) - np.asarray(batch.initial)[:, None])
        rows = [
            predict_ahead(self, command, travel, horizons)
            for command, travel in zip(np.asarray(batch.command), travels, strict=True)
        ]
        return [_displacement(batch, travel) for travel in np.swapaxes(rows, 0, 1)]


def unpadded_tests(batch: Batch) -> list[Test]:
    """Return command, travel and loss mask of each test, without padding."""
    return [
        (np.asarray(command)[valid], np.asarray(travel)[valid], np.asarray(loss_mask)[valid])
        for command, travel, loss_mask, valid in zip(
            batch.command, batch.travel, batch.loss_mask, np.asarray(batch.valid), strict=True
        )
    ]


def predict_ahead(
    model: Autoregression, command: np.ndarray, travel: np.ndarray, horizons: Sequence[int]
) -> np.ndarray:
    """Return h-step-ahead predictions of travel, zero for the first h samples.

    Args:
        model: an autoregressive model; it is iterated from all samples at once.
        command, travel: signals of one test that starts from rest, shape [N].
        horizons: prediction horizons h, in samples.

    Returns:
        Predictions, shape [len(horizons), N].
    """
    lag, count, farthest = model.lag, command.size, max(horizons)
    past = np.concatenate([np.zeros(lag), travel])
    padded_command = np.concatenate([np.zeros(lag), command, np.zeros(farthest)])
    history = [past[lag - i : lag - i + count] for i in range(lag)]
    predictions = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(1, farthest + 1):
            commands = np.stack(
                [padded_command[lag + step - i : lag + step - i + count] for i in range(1, lag + 1)]
            )
            history = [model.predict_next(commands, np.stack(history)), *history[: lag - 1]]
            predictions[step] = history[0]
    return np.stack([np.concatenate([np.zeros(h), predictions[h][: count - h]]) for h in horizons])


def _displacement(batch: Batch, travel: np.ndarray) -> np.ndarray:
    return np.asarray(batch.initial)[:, None] + batch.sign * travel
