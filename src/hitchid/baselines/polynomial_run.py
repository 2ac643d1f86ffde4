"""Free run of a polynomial model from many starts at once, with its derivative by the coefficients."""

from dataclasses import dataclass, field

import numpy as np

from hitchid.baselines.forward_regression import CONSTANT
from hitchid.structures import Batch


@dataclass(frozen=True)
class Sections:
    """Sections of tests, scaled, each preceded by its past; of S sections of N samples.

    Attributes:
        command: command of the past and of the section, shape [S, P + N].
        past: travel before the section, shape [S, P].
        constants: covariates and initial displacement, shape [S, C + 1].
        travel: measured travel of the section, shape [S, N].
        mask: samples that errors are taken over, shape [S, N].
    """

    command: np.ndarray
    past: np.ndarray
    constants: np.ndarray
    travel: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), dtype=bool))

    def regression(self, terms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return terms from measured travel at all samples of the mask, shape [K, M], and their travel."""
        history = np.concatenate([self.past, self.travel], axis=1)
        count, past = self.travel.shape[1], self.past.shape[1]
        travel, command = (
            np.stack([rows[:, past - i : past - i + count][self.mask] for i in range(1, past + 1)], axis=1)
            for rows in (history, self.command)
        )
        constants = np.repeat(self.constants, self.mask.sum(axis=1), axis=0)
        return products(terms, travel, command, constants), self.travel[self.mask]


def sections_of(
    batch: Batch, inputs: np.ndarray, travel: np.ndarray, *, past: int, longest: int, most: int
) -> Sections:
    """Return the sections of tests.

    Args:
        batch: tests.
        inputs: scaled command and constants, shape [T, 2 + C, N].
        travel: scaled travel, shape [T, N].
        past: samples before a section.
        longest: samples of a section at most.
        most: samples of all sections, about; of more every m-th section is returned.
    """
    ends = np.asarray(batch.valid).sum(axis=1)
    width = int(min(longest, ends.max()))
    pad = ((0, 0), (past, width))
    command, history = np.pad(inputs[:, 0], pad), np.pad(travel, pad)
    mask = np.pad(np.asarray(batch.loss_mask), ((0, 0), (0, width)))
    starts = [
        (test, first)
        for test, end in enumerate(ends)
        for first in range(0, end, width)
        if mask[test, first : first + width].any()
    ]
    starts = starts[:: max(1, -(-len(starts) * width // most))]
    return Sections(
        command=np.array([command[test, first : first + past + width] for test, first in starts]),
        past=np.array([history[test, first : first + past] for test, first in starts]),
        constants=np.array([inputs[test, 1:, 0] for test, _ in starts]),
        travel=np.array([history[test, first + past : first + past + width] for test, first in starts]),
        mask=np.array([mask[test, first : first + width] for test, first in starts]),
    )


def products(terms: np.ndarray, travel: np.ndarray, command: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """Return the terms of a polynomial, shape [S, M].

    Args:
        terms: factors of each term, shape [M, 2]; see `Narx`.
        travel, command: scaled, at k−1 … k−n, shape [S, n] each.
        constants: covariates and initial displacement, scaled, shape [S, C + 1].
    """
    signals = np.concatenate([np.ones((len(travel), 1)), travel, command, constants], axis=1)
    columns = _columns(terms, travel.shape[1])
    return signals[:, columns[:, 0]] * signals[:, columns[:, 1]]


def polynomial_run(
    terms: np.ndarray, coefficients: np.ndarray, sections: Sections, lags: int, *, derivative: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return travel simulated from measured pasts, and its derivative by the coefficients.

    A simulation that diverges becomes infinite or NaN, without a warning.

    Args:
        terms: factors of each term, shape [M, 2].
        coefficients: θ, shape [M].
        sections: commands, pasts and constants.
        lags: lags of travel and command that are kept, at most the length of the pasts.
        derivative: whether the derivative is computed.

    Returns:
        Scaled travel, shape [S, N], and its derivative, shape [S, N, M], or [S, N, 0].
    """
    past = sections.past.shape[1]
    starts, count = len(sections.past), sections.command.shape[1] - past
    columns = _columns(terms, lags)
    signals = np.concatenate([np.ones((starts, 1)), np.zeros((starts, 2 * lags)), sections.constants], axis=1)
    travel = np.concatenate([sections.past, np.zeros((starts, count))], axis=1)
    sensitivities = np.zeros((starts, past + count, len(terms) if derivative else 0))
    selection = [np.eye(signals.shape[1])[column][:, 1 : lags + 1] for column in columns.T]
    with np.errstate(all="ignore"):
        for k in range(past, past + count):
            signals[:, 1 : lags + 1] = travel[:, k - lags : k][:, ::-1]
            signals[:, lags + 1 : 2 * lags + 1] = sections.command[:, k - lags : k][:, ::-1]
            first, second = signals[:, columns[:, 0]], signals[:, columns[:, 1]]
            values = first * second
            travel[:, k] = values @ coefficients
            if derivative:
                slopes = (coefficients * second) @ selection[0] + (coefficients * first) @ selection[1]
                recent = sensitivities[:, k - lags : k][:, ::-1]
                sensitivities[:, k] = values + (slopes[:, None, :] @ recent)[:, 0]
    return travel[:, past:], sensitivities[:, past:]


def _columns(terms: np.ndarray, lags: int) -> np.ndarray:
    """Return the columns, among 1, w(k−1) …, u(k−1) … and constants, that are the factors of terms."""
    constants = np.where(terms >= CONSTANT, 2 * lags + 1 + terms - CONSTANT, terms)
    return np.where(terms < 0, lags - terms, constants)
