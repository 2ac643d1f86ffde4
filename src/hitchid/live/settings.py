"""Settings of the adaptation."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hitchid._support import checks
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.live.parameters import NAMES

# Detection of a change of speed: a two-sided cumulative sum of the standardised errors of strokes.

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
        faster = max(0.0, self.faster + bounded - REFERENCE)
        return ChangeDetector(faster, max(0.0, self.slower - bounded - REFERENCE))

    @property
    def sum(self) -> float:
        """The larger sum."""
        return max(self.faster, self.slower)


@lru_cache
def alarm_threshold(strokes_between_alarms: float) -> float:
    """Return h at which streams without a change have a mean number of strokes between alarms.

    Textbook thresholds are for normal errors of known scale. Here scale and mean are those of some twenty
    strokes, so that each simulated stream has its own, and its errors are of Student's t. The mean number is
    over all streams, of a direction, and at most `MOST_STROKES_BETWEEN`.
    """
    freedom = DEGREES_OF_FREEDOM
    rng = np.random.default_rng(0)  # one threshold for all machines and runs
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
        faster[alarm], slower[alarm] = 0.0, 0.0  # as a channel's detector begins anew after an alarm
    between = REPLICATES * STROKES / np.maximum(alarms, 1.0)
    return float(THRESHOLDS[np.flatnonzero(between >= strokes_between_alarms)[0]])


@short_repr
@dataclass(frozen=True)
class AdaptationSettings:
    """What adaptation may change, how far, and on what evidence.

    Shares of the command refer to the largest effective command of the identification tests.

    Attributes:
        parameters: that may move: `gain`, `dead_zone`, `lag`.
        window: strokes of a direction that are fitted together.
        largest_gain: largest change of the gain since the identification, relative.
        largest_dead_zone: largest change of the dead zone, share of the command; at most 0.15 A.
        change_per_stroke: largest change of a parameter from one stroke of the machine to the next: relative
            for the gain, share of the command for the dead zone.
        gain_scatter: standard deviation of the speed from stroke to stroke that no parameter explains,
            relative.
        dead_zone_scatter: the same of the dead zone, share of the command.
        gain_drift, dead_zone_drift: standard deviation by which the parameters wander from stroke to stroke,
            relative and as a share of the command.
        evidence: likelihood ratio over later strokes at which a candidate replaces the model in use.
        improvement: by which share its error over them must be smaller.
        patience: strokes after which a candidate that has not proved better is dropped.
        shortest_travel: of a stroke that is learned from, share of the range of the tests.
        strokes_between_alarms: mean number of strokes of a direction between two false alarms of a change,
            at most 50 000.
        coverage: of the bands.
    """

    parameters: tuple[str, ...] = ("gain", "dead_zone", "lag")
    window: int = 8
    largest_gain: float = 0.5
    largest_dead_zone: float = 0.15
    change_per_stroke: float = 0.05
    gain_scatter: float = 0.015
    dead_zone_scatter: float = 0.004
    gain_drift: float = 0.005
    dead_zone_drift: float = 0.001
    evidence: float = 100.0
    improvement: float = 0.05
    patience: int = 6
    shortest_travel: float = 0.04
    strokes_between_alarms: float = 5000.0
    coverage: float = 0.9

    def __post_init__(self) -> None:
        """Check the settings; raise InputError for one that is not possible."""
        checks.tuple_of(self.parameters, str, "parameters", f"names out of {', '.join(NAMES)}")
        for name in self.parameters:
            checks.one_of(name, NAMES, "parameters")
        if "gain" not in self.parameters:
            raise InputError(f"parameters: expected 'gain' among them, got {', '.join(self.parameters)}")
        checks.integer(self.window, "window", minimum=2)
        checks.integer(self.patience, "patience", minimum=1)
        for name in (
            "largest_gain",
            "largest_dead_zone",
            "change_per_stroke",
            "gain_scatter",
            "dead_zone_scatter",
            "gain_drift",
            "dead_zone_drift",
            "improvement",
            "shortest_travel",
        ):
            if checks.number(getattr(self, name), name, above=0.0) >= 1:
                raise InputError(f"{name}: expected a share below 1, got {getattr(self, name):g}")
        checks.number(self.evidence, "evidence", above=1.0)
        between = checks.number(self.strokes_between_alarms, "strokes_between_alarms", above=1.0)
        if between > MOST_STROKES_BETWEEN:
            raise InputError(
                f"strokes_between_alarms: got {between:g}, expected at most {MOST_STROKES_BETWEEN:g}; rarer "
                "alarms are beyond what their thresholds were simulated for"
            )
