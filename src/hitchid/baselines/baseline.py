"""Interface of a kind of baseline: name, fit, and skeleton for loading."""

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
        hidden: number of cells of an LSTM.
        adam: settings of Adam and of early stopping.
        key: random key for initial weights and shuffling.
        progress: called after each epoch of a training with its number, training and validation loss.
        checkpoints: store for finished parts of a fit, read again when a fit is resumed.
    """

    hidden: int
    adam: AdamConfig
    key: PRNGKeyArray
    progress: EpochCallback | None = None
    checkpoints: Checkpoints = DISABLED


class Baseline(ABC):
    """A kind of baseline.

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
            training, validation: tests for the fit, and for model selection or early stopping.
            context: settings of the fit.
        """

    @abstractmethod
    def skeleton(self, shapes: Sizes) -> FittedBaseline:
        """Return a fitted baseline of given shapes; loading replaces its arrays by the stored ones.

        Args:
            shapes: name of each stored array to its shape.
        """
