"""Persistence: the displacement stays what was measured last."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hitchid.baselines.fitted import FittedBaseline
from hitchid.structures import Batch


class Persistence(FittedBaseline):
    """y(k) = y(k−h); from the start of a test y(k) = y(0). It has nothing to fit and is not stored."""

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return the initial displacement throughout, shape [T, N]."""
        return np.broadcast_to(np.asarray(batch.initial)[:, None], batch.command.shape)

    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]]:
        """Return for each h the displacement measured h samples before, shape [T, N]."""
        measured = np.asarray(batch.displacement)
        return [delayed(measured, h) for h in horizons]


def delayed(rows: Float[np.ndarray, "t n"], samples: int) -> Float[np.ndarray, "t n"]:
    """Return rows so many samples later; the first samples stay."""
    return np.concatenate([rows[:, :samples], rows[:, :-samples]], axis=1)
