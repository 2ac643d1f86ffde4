"""Factor on the half width of a band that keeps its coverage while the machine changes."""

from typing import NamedTuple

import numpy as np

from hitchid._support.short_repr import short_repr

RATE = 0.5  # change of the log factor by a stroke all of whose samples are outside; chosen
LARGEST = 4.0  # log factor, either way; chosen


@short_repr
class BandFactor(NamedTuple):
    """Logarithm l of the factor, moved after each stroke: l ← l + η (e − α), e the share outside.

    Whatever the strokes are, the mean share outside over T of them differs from α by at most
    2 · 4/(η T) while l is within its limits: adaptive conformal inference (Gibbs & Candès 2021, NeurIPS), of
    the quantile itself (Angelopoulos, Candès & Tibshirani 2023, NeurIPS).

    Attributes:
        log: l.
    """

    log: float = 0.0

    @property
    def factor(self) -> float:
        """The factor on the half width."""
        return float(np.exp(self.log))

    def advance(self, outside: float, expected: float) -> "BandFactor":
        """Return the factor after one more stroke.

        Args:
            outside: e, share of its samples outside the band.
            expected: α, one minus the coverage.
        """
        return BandFactor(float(np.clip(self.log + RATE * (outside - expected), -LARGEST, LARGEST)))
