"""Inputs of the linear baselines, and their tests without padding."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from hitchid.structures import Batch

INPUT_COUNTS = (2, 4)  # inputs that are compared: with the command alone, and with constants as well


class LinearInputs(eqx.Module):
    """Inputs of a linear model of travel: command, command times load, 1, and initial displacement.

    The load multiplies the command, for without one it moves nothing; it is zero where none is measured.

    Attributes:
        load_centre, load_scale: scaling of the load before motion, shape [].
        initial_centre, initial_scale: scaling of the initial displacement, shape [].
    """

    load_centre: np.ndarray
    load_scale: np.ndarray
    initial_centre: np.ndarray
    initial_scale: np.ndarray

    @classmethod
    def of(cls, batch: Batch) -> "LinearInputs":
        """Return the inputs scaled to tests."""
        load, initial = np.asarray(batch.covariate), np.asarray(batch.initial)
        return cls(*map(np.asarray, (load.mean(), load.std() or 1.0, initial.mean(), initial.std() or 1.0)))

    @classmethod
    def unfilled(cls) -> "LinearInputs":
        """Return inputs whose scaling is zero, to be filled with the stored one."""
        return cls(*(np.zeros(()) for _ in range(4)))

    def constants(self, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        """Return load and initial displacement of each test, scaled, shape [T] each."""
        load = (np.asarray(batch.covariate) - self.load_centre) / self.load_scale
        return load, (np.asarray(batch.initial) - self.initial_centre) / self.initial_scale

    def rows(self, batch: Batch, count: int) -> np.ndarray:
        """Return the first inputs of each test, shape [T, count, N]."""
        command = np.asarray(batch.command)
        load, initial = self.constants(batch)
        inputs = (
            command,
            load[:, None] * command,
            np.ones_like(command),
            np.broadcast_to(initial[:, None], command.shape),
        )
        return np.stack(inputs[:count], axis=1)


class UnpaddedTest(NamedTuple):
    """One test from rest, without padding.

    Attributes:
        inputs: shape [m, N].
        travel: displacement relative to the start, shape [N].
        loss_mask: samples that errors are taken over, shape [N].
    """

    inputs: np.ndarray
    travel: np.ndarray
    loss_mask: np.ndarray


def unpadded_tests(batch: Batch, inputs: np.ndarray) -> list[UnpaddedTest]:
    """Return each test without padding; inputs of shape [T, m, N]."""
    rows = zip(inputs, batch.travel, batch.loss_mask, np.asarray(batch.valid), strict=True)
    return [
        UnpaddedTest(u[:, valid], np.asarray(w)[valid], np.asarray(mask)[valid]) for u, w, mask, valid in rows
    ]


def free_run_error(simulated: Sequence[np.ndarray], tests: Sequence[UnpaddedTest]) -> float:
    """Return the sum of squared errors of simulated travel, infinite where one diverged."""
    with np.errstate(all="ignore"):
        errors = [travel - test.travel for travel, test in zip(simulated, tests, strict=True)]
        total = sum(
            float(np.sum(error[test.loss_mask] ** 2)) for error, test in zip(errors, tests, strict=True)
        )
    return total if np.isfinite(total) else np.inf
