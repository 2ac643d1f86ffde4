"""What a grey box must beat: ARX and a black-box LSTM, fitted on the same tests.

Persistence needs no fitting: the last measured displacement, for any horizon.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.lstm import SINGLE, Lstm


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
            [_lagged(travel, command, order)[counted] for command, travel, counted in tests]
        )
        target = np.concatenate([travel[counted] for _, travel, counted in tests])
        solution = np.linalg.lstsq(rows, target, rcond=None)[0]
        return cls(solution[:order], solution[order:])

    @property
    def lag(self) -> int:
        """The longest lag n."""
        return self.past.size

    def following(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
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

    def following(self, command: np.ndarray, travel: np.ndarray) -> np.ndarray:
        """Return w(k) from u(k−1) … u(k−n) and w(k−1) … w(k−n), shape [n, N] each."""
        ...


def ahead(
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
    heard = np.concatenate([np.zeros(lag), command, np.zeros(farthest)])
    known = [past[lag - i : lag - i + count] for i in range(lag)]
    found = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for step in range(1, farthest + 1):
            commands = np.stack([heard[lag + step - i : lag + step - i + count] for i in range(1, lag + 1)])
            known = [model.following(commands, np.stack(known)), *known[: lag - 1]]
            found[step] = known[0]
    return np.stack([np.concatenate([np.zeros(h), found[h][: count - h]]) for h in horizons])


class BlackBox(eqx.Module):
    """LSTM from commands to speed, integrated: no physics but that displacement is the sum of its changes.

    w(k) = σ Σ_{i<k} f(u(0) … u(i), x(0)), simulated from the start of a test.

    Attributes:
        network: the LSTM, reading command and initial displacement.
        command_scale: largest command of training, shape [].
        initial_centre, initial_scale: scaling of the initial displacement, shape [].
        change: σ, typical change of displacement in one sample, shape [].
    """

    network: Lstm
    command_scale: Float[Array, ""]
    initial_centre: Float[Array, ""]
    initial_scale: Float[Array, ""]
    change: Float[Array, ""]

    def inputs(self, command: Float[Array, "t n"], initial: Float[Array, " t"]) -> Float[Array, "t n 2"]:
        """Return the scaled inputs, shape [T, N, 2]."""
        height = (initial - self.initial_centre) / self.initial_scale
        wide = jnp.broadcast_to(height[:, None], command.shape)
        return jnp.stack([command / self.command_scale, wide], axis=-1).astype(SINGLE)

    def free_run(self, command: Float[Array, "t n"], initial: Float[Array, " t"]) -> Float[Array, "t n"]:
        """Return travel simulated from commands and initial displacement, shape [T, N]."""
        changes = speeds(self.network, self.inputs(command, initial))
        return self.change * accumulated(changes)


def speeds(network: Lstm, inputs: Float[Array, "t n i"]) -> Float[Array, "t n"]:
    """Return the network's output at every sample of every test, shape [T, N]."""
    rows = jnp.swapaxes(inputs, 0, 1)
    return network.outputs(rows, jnp.ones(rows.shape[:2], bool)).T


def accumulated(changes: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return the sum of all changes before each sample, shape [T, N]."""
    return jnp.cumsum(changes, axis=1) - changes
