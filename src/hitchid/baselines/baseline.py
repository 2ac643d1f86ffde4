"""Interface of a kind of baseline: name, fit, and skeleton for loading."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.records import short_repr
from hitchid.estimation.training import EpochCallback
from hitchid.structures import Batch

# Interface of a fitted baseline: free run and predictions.


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


Sizes = Mapping[str, Sequence[int]]


@dataclass(frozen=True)
class FitContext:
    """Settings of a fit.

    Attributes:
        gradient_steps: largest number of gradient steps of a training.
        key: random key for initial weights.
        progress: called during a training with the steps done, training and validation error.
        checkpoints: store for finished parts of a fit, read again when a fit is resumed.
    """

    gradient_steps: int
    key: PRNGKeyArray
    progress: EpochCallback | None = None
    checkpoints: Checkpoints = DISABLED


class Baseline(ABC):
    """A kind of baseline.

    Attributes:
        name: key in `metrics.json` and in the model folder, lower case.
        title: name in tables, progress and notices.
        quick: whether it is fitted beside every model, for it costs little; the others are on request.
    """

    name: str
    title: str
    quick: bool = False

    @abstractmethod
    def fit(self, tests: Batch, context: FitContext) -> FittedBaseline | None:
        """Fit to all identification tests of a direction; None where the fit is not possible.

        What is chosen, such as an order or the end of a training, is chosen by `split_validation` of the
        tests; the model is then fitted to all of them. The tests have the covariates that the physics model
        may use, and so has every batch that the fitted baseline is given.

        Args:
            tests: all identification tests.
            context: settings of the fit.

        Raises:
            FitError: the fit failed; a notice says so, and the baseline is left out.
        """

    @abstractmethod
    def skeleton(self, shapes: Sizes) -> FittedBaseline:
        """Return a fitted baseline of given shapes; loading replaces its arrays by the stored ones.

        Args:
            shapes: name of each stored array to its shape.
        """
