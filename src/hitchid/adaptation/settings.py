"""Settings of the adaptation."""

from dataclasses import dataclass

from hitchid._support import checks
from hitchid._support.short_repr import short_repr
from hitchid.adaptation.change_detection import MOST_STROKES_BETWEEN
from hitchid.adaptation.parameters import NAMES
from hitchid.errors import InputError


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
