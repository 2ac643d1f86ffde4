"""Detection of a change of speed: a two-sided cumulative sum of the standardised errors of strokes."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hitchid._support.short_repr import short_repr

# Of a stroke's error, standard deviations: what is subtracted from each, half a change of two; largest that
# counts, so that no single stroke raises an alarm. Chosen.
REFERENCE, LARGEST = 1.0, 6.0
REPLICATES, STROKES = 64, 8_000  # simulated streams, and strokes of each; chosen: h is within a fifth
# Largest mean number of strokes between alarms: ten alarms in the simulated strokes. Chosen.
MOST_STROKES_BETWEEN = 50_000.0
# That are tried, standard deviations: from above what one stroke adds to twice what the rarest alarms need.
THRESHOLDS = np.linspace(LARGEST, 24.0, 37)
# Strokes over which the scale of the errors is learned, so that its error is that of as many; see
# `stroke_scatter`.
DEGREES_OF_FREEDOM = 20


@short_repr
class ChangeDetector(NamedTuple):
    """Cumulative sums of errors that are too large or too small (Page 1954, Biometrika 41, 100).

    s⁺ = max(0, s⁺ + z − k) and s⁻ = max(0, s⁻ − z − k) with z within ±6; an alarm is s > h.

    Attributes:
        faster, slower: s⁺ and s⁻.
    """

    faster: float = 0.0
    slower: float = 0.0

    def advance(self, error: float) -> "ChangeDetector":
        """Return the sums after one more stroke, `error` being z."""
        bounded = float(np.clip(error, -LARGEST, LARGEST))
        faster, slower = (
            max(0.0, self.faster + bounded - REFERENCE),
            max(0.0, self.slower - bounded - REFERENCE),
        )
        return ChangeDetector(faster, slower)

    @property
    def sum(self) -> float:
        """The larger sum."""
        return max(self.faster, self.slower)


@lru_cache
def alarm_threshold(strokes_between_alarms: float) -> float:
    """Return h at which streams without a change have a mean number of strokes between alarms.

    Textbook thresholds are for normal errors of known scale. Here scale and mean are those of some twenty
    strokes, so that each simulated stream has its own, and its errors are of Student's t.

    Args:
        strokes_between_alarms: mean over all streams, of a direction; at most `MOST_STROKES_BETWEEN`.
    """
    freedom = DEGREES_OF_FREEDOM
    rng = np.random.default_rng(0)
    scale = np.sqrt(rng.chisquare(freedom, REPLICATES) / freedom)
    mean = rng.standard_normal(REPLICATES) / np.sqrt(freedom + 1)
    faster, slower = np.zeros((2, THRESHOLDS.size, REPLICATES))
    alarms = np.zeros(THRESHOLDS.size)
    for _ in range(STROKES):
        error = np.clip((rng.standard_normal(REPLICATES) + mean) / scale, -LARGEST, LARGEST)
        faster = np.maximum(0.0, faster + error - REFERENCE)
        slower = np.maximum(0.0, slower - error - REFERENCE)
        alarm = np.maximum(faster, slower) > THRESHOLDS[:, None]
        alarms += alarm.sum(axis=1)
        faster[alarm], slower[alarm] = 0.0, 0.0
    between = REPLICATES * STROKES / np.maximum(alarms, 1.0)
    return float(THRESHOLDS[np.flatnonzero(between >= strokes_between_alarms)[0]])
