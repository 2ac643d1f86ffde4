"""What a fitted baseline provides: simulation and predictions."""

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hitchid.structures import Batch


class FittedBaseline(eqx.Module):
    """A baseline fitted to the tests of one direction; its arrays are stored beside the model."""

    @abstractmethod
    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""

    @abstractmethod
    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]] | None:
        """Return for each h displacement predicted from that measured up to h samples before, shape [T, N].

        None where the baseline only simulates. Its prediction is then the displacement measured h samples
        before plus the simulated increment since.
        """
