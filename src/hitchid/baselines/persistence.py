"""Persistence baseline: the last measured displacement is the prediction."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hitchid.baselines.fitted import FittedBaseline
from hitchid.structures import Batch


class Persistence(FittedBaseline):
    """y(k) = y(k−h); in free run y(k) = y(0). It has no parameters and is not stored."""

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return the initial displacement at every sample, shape [T, N]."""
        return np.broadcast_to(np.asarray(batch.initial)[:, None], batch.command.shape)

    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]]:
        """Return for each h the displacement measured h samples before, shape [T, N]."""
        measured = np.asarray(batch.displacement)
        return [delayed(measured, h) for h in horizons]


def delayed(rows: Float[np.ndarray, "t n"], samples: int) -> Float[np.ndarray, "t n"]:
    """Return rows delayed by a number of samples; the first samples are not changed."""
    return np.concatenate([rows[:, :samples], rows[:, :-samples]], axis=1)
