"""Division of the identification tests into training and validation tests."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from hitchid.structures.batch import Batch

VALIDATION_EVERY = 4  # chosen: every fourth test chooses orders and stops trainings
VALIDATION_FRACTION = 0.25  # share of one test alone that does


def validation_rows(tests: int) -> list[int]:
    """Return the positions of the validation tests: every fourth, of two or three tests the last."""
    return list(range(VALIDATION_EVERY - 1, tests, VALIDATION_EVERY)) or [tests - 1]


def validation_mask(batch: Batch) -> Bool[Array, "t n"]:
    """Return which samples of the loss mask validate: all of the validation tests, of one test the last
    quarter."""
    if len(batch.command) == 1:
        cumulative_count = jnp.cumsum(batch.loss_mask, axis=1)
        return batch.loss_mask & (cumulative_count > (1 - VALIDATION_FRACTION) * cumulative_count[:, -1:])
    is_validation = np.isin(np.arange(len(batch.command)), validation_rows(len(batch.command)))
    return batch.loss_mask & is_validation[:, None]


def split_validation(batch: Batch) -> tuple[Batch, Batch, list[int]]:
    """Return training and validation tests, and the positions of the latter.

    One test alone is both, with errors taken over different samples.
    """
    tests = len(batch.command)
    rows, mask = validation_rows(tests), validation_mask(batch)
    if tests == 1:
        return batch.masked(~mask), batch.masked(mask), rows
    return batch.take([row for row in range(tests) if row not in rows]), batch.take(rows), rows
