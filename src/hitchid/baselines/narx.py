"""A polynomial autoregression with input (NARX), a common black box: simulated here, fitted elsewhere."""

from math import prod

import equinox as eqx
import numpy as np


class Narx(eqx.Module):
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

    def free_run(self, command: np.ndarray) -> np.ndarray:
        """Return travel simulated from the command alone, from rest, shape [N].

        What diverges becomes infinite or not a number, without a warning.
        """
        return self.simulate_from(_prepend_zeros(command, self.lag), np.zeros(self.lag))

    def simulate_from(self, command: np.ndarray, past: np.ndarray) -> np.ndarray:
        """Return travel simulated on from a measured past, shape [N]; see `free_run`.

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


def _prepend_zeros(samples: np.ndarray, count: int) -> np.ndarray:
    return np.concatenate([np.zeros(count), samples])
