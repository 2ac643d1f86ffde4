"""Linear autoregression with input (ARX), and predictions by any autoregression from measured samples."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np


class Arx(eqx.Module):
    """Linear autoregression with input on travel w (displacement away from the start).

    w(k) = Σ aᵢ w(k−i) + Σ bᵢ u(k−i), i = 1 … n.

    Attributes:
        past: a, shape [n].
        command: b, shape [n].
    """

    past: np.ndarray
    command: np.ndarray

    @classmethod
    def fit(cls, tests: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], order: int) -> "Arx":
        """Fit by least squares to command, travel and which samples count, each of shape [N_i], from rest."""
        rows = np.concatenate(
            [_lagged(travel, command, order)[loss_mask] for command, travel, loss_mask in tests]
        )
        target = np.concatenate([travel[loss_mask] for _, travel, loss_mask in tests])
        solution = np.linalg.lstsq(rows, target, rcond=None)[0]
        return cls(solution[:order], solution[order:])

    @property
    def lag(self) -> int:
        """The longest lag n."""
        return self.past.size

    def predict_next(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n) and w(k−1) … w(k−n), shape [n, N] each."""
        return self.command @ command + self.past @ travel

    def one_step(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return travel predicted from measured travel up to the sample before, shape [N]."""
        return _lagged(travel, command, self.past.size) @ np.concatenate([self.past, self.command])

    def free_run(self, command: np.ndarray) -> np.ndarray:
        """Return travel simulated from the command alone, shape [N]."""
        from scipy.signal import lfilter  # not at the top: half a second

        return np.asarray(lfilter(np.append(0.0, self.command), np.append(1.0, -self.past), command))


def _lagged(travel: np.ndarray, command: np.ndarray, order: int) -> np.ndarray:
    """Return rows [w(k−1) … w(k−n), u(k−1) … u(k−n)], zero before the test, shape [N, 2 n]."""

    def lags(samples: np.ndarray) -> np.ndarray:
        padded = np.concatenate([np.zeros(order), samples[:-1]])
        return np.lib.stride_tricks.sliding_window_view(padded, order)[:, ::-1]

    return np.hstack([lags(travel), lags(command)])


@runtime_checkable
class Autoregression(Protocol):
    """What predicts travel from the last of its own and of the command's samples."""

    @property
    def lag(self) -> int:
        """The longest lag n."""
        ...

    def predict_next(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n) and w(k−1) … w(k−n), shape [n, N] each."""
        ...


def predict_ahead(
    model: Autoregression, command: np.ndarray, travel: np.ndarray, horizons: Sequence[int]
) -> np.ndarray:
    """Return travel predicted from measured travel up to h samples before, zero for the first h samples.

    Args:
        model: what is iterated, from every sample at once.
        command, travel: of one test, from rest, shape [N].
        horizons: the h asked for, in samples.

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
