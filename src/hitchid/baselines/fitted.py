"""Interface of a fitted baseline: free run and predictions."""

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hitchid._support.short_repr import short_repr
from hitchid.structures import Batch


@short_repr
class FittedBaseline(eqx.Module):
    """A baseline fitted to the tests of one direction; its arrays are stored in the model folder."""

    @abstractmethod
    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""

    @abstractmethod
    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]] | None:
        """Return the h-step-ahead predictions of displacement, for each h, shape [T, N] each.

        None where the baseline only simulates; the caller then takes the displacement measured h samples
        before plus the simulated increment since.
        """
