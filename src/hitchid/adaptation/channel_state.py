"""State of the adaptation of one channel."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.change_detection import ChangeDetector
from hitchid.adaptation.conformal import BandFactor
from hitchid.adaptation.estimator import Estimate
from hitchid.adaptation.parameters import Changes
from hitchid.adaptation.strokes import Stroke

Numbered = tuple[int, Stroke]  # a stroke with its number
# Log likelihood ratio of one stroke that counts: after a sudden change one later stroke may decide, otherwise
# not. Chosen.
LARGEST_EVIDENCE, LARGEST_EVIDENCE_AFTER_CHANGE = 4.0, 10.0


@short_repr
class Trial(NamedTuple):
    """Comparison of other changes with the promoted ones, over the strokes since it began.

    Attributes:
        changes: that are tried.
        after_change: whether they are those of strokes since a sudden change alone.
        evidence: log likelihood ratio in their favour.
        squares, against: sums over the strokes of the mean square error, of them and of the promoted ones.
        strokes: compared.
    """

    changes: Changes
    after_change: bool = False
    evidence: float = 0.0
    squares: float = 0.0
    against: float = 0.0
    strokes: int = 0

    def with_stroke(self, evidence: float, square: float, against: float) -> "Trial":
        """Return the comparison after one more stroke."""
        largest = LARGEST_EVIDENCE_AFTER_CHANGE if self.after_change else LARGEST_EVIDENCE
        return self._replace(
            evidence=self.evidence + float(np.clip(evidence, -largest, largest)),
            squares=self.squares + square,
            against=self.against + against,
            strokes=self.strokes + 1,
        )


@short_repr
@dataclass(frozen=True)
class ChannelState:
    """State of the adaptation of one channel.

    Attributes:
        deployed: changes in use.
        target: changes that were promoted; those in use approach them.
        snapshots: changes that were promoted before, the latest last.
        arrival: estimate before the window.
        estimate: after the latest stroke.
        window: strokes that are fitted, the latest last.
        suspects: latest strokes that are far from the estimate: a sudden change, or a disturbance.
        detector: of changes of the speed.
        candidates: changes that are tried, the latest last.
        watch: those before the last promotion, which may return; None where that is decided.
        band: factor on the half width of the bands.
        scatter: factor on the scatter of the settings that the strokes show.
        misfit: share of the travel that is usually left as error after gain and dead zone are fitted.
    """

    deployed: Changes
    target: Changes
    snapshots: tuple[Changes, ...]
    arrival: Estimate
    estimate: Estimate
    band: BandFactor
    window: tuple[Numbered, ...] = ()
    suspects: tuple[Numbered, ...] = ()
    detector: ChangeDetector = field(default_factory=ChangeDetector)
    candidates: tuple[Trial, ...] = ()
    watch: Trial | None = None
    scatter: float = 1.0
    misfit: float = 0.02
