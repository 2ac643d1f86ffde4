"""Interface of a kind of baseline: name, fit, and skeleton for loading."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jaxtyping import PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid.baselines.fitted import FittedBaseline as FittedBaseline
from hitchid.estimation.training import EpochCallback
from hitchid.structures import Batch

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
