"""Inputs of the linear baselines, and their tests without padding."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from hitchid.structures import Batch


class LinearInputs(eqx.Module):
    """Inputs of a linear model of travel: command, command times each covariate, 1, initial displacement.

    A covariate multiplies the command, for without one it moves nothing; there is one of zeros where none is
    measured.

    Attributes:
        load_centre, load_scale: scaling of the covariates before motion, shape [C].
        initial_centre, initial_scale: scaling of the initial displacement, shape [].
    """

    load_centre: np.ndarray
    load_scale: np.ndarray
    initial_centre: np.ndarray
    initial_scale: np.ndarray

    @classmethod
    def of(cls, batch: Batch) -> "LinearInputs":
        """Return the inputs scaled to tests."""
        initial = np.asarray(batch.initial)
        scaling = *covariate_scaling(batch), initial.mean(), initial.std() or 1.0
        return cls(*map(np.asarray, scaling))

    @classmethod
    def unfilled(cls, covariates: int) -> "LinearInputs":
        """Return inputs whose scaling is zero, to be filled with the stored one."""
        return cls(*(np.zeros(shape) for shape in ((covariates,), (covariates,), (), ())))

    def constants(self, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        """Return covariates and initial displacement of each test, scaled, shapes [T, C] and [T]."""
        load = (covariates_of(batch) - self.load_centre) / self.load_scale
        return load, (np.asarray(batch.initial) - self.initial_centre) / self.initial_scale

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of inputs that are compared: the command alone and with the covariates, and all."""
        return 1 + self.load_centre.size, 3 + self.load_centre.size

    def rows(self, batch: Batch, count: int) -> np.ndarray:
        """Return the first inputs of each test, shape [T, count, N]."""
        command = np.asarray(batch.command)
        load, initial = self.constants(batch)
        inputs = (
            command,
            *(column[:, None] * command for column in load.T),
            np.ones_like(command),
            np.broadcast_to(initial[:, None], command.shape),
        )
        return np.stack(inputs[:count], axis=1)


def covariates_of(batch: Batch) -> np.ndarray:
    """Return the covariates of each test, one of zeros where there is none, shape [T, C]."""
    return np.asarray(batch.load(batch.covariate_names))


def covariate_scaling(batch: Batch) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation of each covariate, one where it does not vary, shape [C] each."""
    loads = covariates_of(batch)
    spread = loads.std(axis=0)
    return loads.mean(axis=0), np.where(spread > 0, spread, 1.0)


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
