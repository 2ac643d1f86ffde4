"""Interface of a fitted baseline: free run and predictions; a model folder is read without what fits one."""

from abc import abstractmethod
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hitchid._support.records import short_repr
from hitchid.structures import Batch


@short_repr
class FittedBaseline(eqx.Module):
    """A baseline fitted to the tests of one direction; its arrays are stored in the model folder."""

    @abstractmethod
    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""

    def check(self, covariates: int) -> None:
        """Check the numbers of a model that was read, whose arrays have the shapes of its skeleton.

        Args:
            covariates: how many the tests have, 1 where they have none.

        Raises:
            ValueError: a number is none that a fit gives.
        """

    @abstractmethod
    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]] | None:
        """Return the h-step-ahead predictions of displacement, for each h, shape [T, N] each.

        None where the baseline only simulates; the caller then takes the displacement measured h samples
        before plus the simulated increment since.
        """
