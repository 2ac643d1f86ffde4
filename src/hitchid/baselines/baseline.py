"""One kind of baseline: its fit, and what the model folder needs to load it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jaxtyping import PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid.baselines.fitted import FittedBaseline
from hitchid.estimation.training import AdamConfig, EpochCallback
from hitchid.structures import Batch

Sizes = Mapping[str, Sequence[int]]


@dataclass(frozen=True)
class FitContext:
    """Settings of a fit.

    Attributes:
        hidden: cells of a network.
        adam: Adam and early stopping of a training.
        key: for random draws.
        progress: called after each epoch of a training with its number, training and validation loss.
        checkpoints: where finished pieces of a fit are kept and found again.
    """

    hidden: int
    adam: AdamConfig
    key: PRNGKeyArray
    progress: EpochCallback | None = None
    checkpoints: Checkpoints = DISABLED


class Baseline(ABC):
    """One kind of baseline.

    Attributes:
        name: key in `metrics.json` and in the model folder, lower case.
        title: name in tables, progress and notices.
    """

    name: str
    title: str

    @abstractmethod
    def fit(self, training: Batch, validation: Batch, context: FitContext) -> FittedBaseline | None:
        """Fit to the tests that the compensator is trained on; None where the fit is not possible.

        Args:
            training, validation: tests; the second ones select among fits.
            context: settings of the fit.
        """

    @abstractmethod
    def skeleton(self, shapes: Sizes) -> FittedBaseline:
        """Return a fitted baseline of given shapes, whose arrays are replaced when a model is loaded.

        Args:
            shapes: name of each stored array to its shape.
        """
