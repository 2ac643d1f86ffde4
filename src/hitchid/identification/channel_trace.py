"""Settings and trace of the identification of one direction."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from hitchid._support.checkpoints import DISABLED, Checkpoints
from hitchid._support.records import short_repr
from hitchid.estimation import Search
from hitchid.estimation.training import TrainingHistory
from hitchid.identification.candidates import Candidate, held_out_errors_of_choice
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.phase1 import Phase1
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.selection import AutoStructure
from hitchid.identification.speed_training import HoldoutTest
from hitchid.model import Characteristics, Rivals, Uncertainty
from hitchid.structures import ModelSpec


@short_repr
@dataclass(frozen=True)
class ChannelTrace:
    """How one direction was identified.

    Attributes:
        dead_zone: the dead zone and its origin.
        phase1: benchmark, parameters, search.
        phase2: losses of the training of the compensator for predictions; None where none was trained.
        holdout_test: test of the compensator for free run on tests held out; None where none was trained.
        notices: remarks on the data and on choices made automatically.
        candidates: the candidates that were compared by an automatic choice of structure.
        seconds: name of each fit to its duration, s.
        uncertainty: of the channel.
        rivals: fitted to the same tests.
        characteristics: speed map, dead zone, delay and response time; None where there are none.
    """

    dead_zone: DeadZone
    phase1: Phase1
    phase2: TrainingHistory | None = None
    holdout_test: HoldoutTest | None = None
    notices: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None
    rivals: Rivals | None = None
    characteristics: Characteristics | None = None

    @property
    def choice_held_out_rmse(self) -> float | None:
        """Free-run RMSE on operating points that neither fitted nor chose the structure.

        See `held_out_errors_of_choice`; None where no structure was chosen.
        """
        if not self.candidates:
            return None
        return float(np.sqrt(np.mean(held_out_errors_of_choice(self.candidates) ** 2)))


@dataclass(frozen=True)
class ChannelConfig:
    """Settings of the identification of one direction.

    Attributes:
        spec: model specification of the benchmark, or its automatic choice.
        paper_spec: model specification of the paper's method, fitted for comparison.
        search: of phase 1.
        training: of phase 2; None for the benchmark alone.
        seed: seed of all random draws.
        units: `x` and `u` to the units of displacement and command.
        quick_rivals: whether the rivals that cost little are fitted.
        checkpoints: store of finished partial results.
    """

    spec: ModelSpec | AutoStructure
    paper_spec: ModelSpec
    search: Search
    training: CompensatorConfig | None
    seed: int
    units: Mapping[str, str]
    quick_rivals: bool = True
    checkpoints: Checkpoints = DISABLED

    @property
    def search_spec(self) -> ModelSpec:
        """The structure that searches are compared on: the given one, or the first of an automatic choice."""
        return self.spec.baseline_spec if isinstance(self.spec, AutoStructure) else self.spec


@contextmanager
def timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    """Store the duration of the block, s, under a name."""
    started = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - started
