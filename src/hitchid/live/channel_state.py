"""State of the adaptation of one channel."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid._support.records import short_repr
from hitchid.live.estimator import Estimate, Vector, conditional_mean, window_estimate, with_scatter
from hitchid.live.gates import Bounds
from hitchid.live.parameters import DEAD_ZONE, GAIN, Changes
from hitchid.live.settings import ChangeDetector
from hitchid.live.stroke_errors import StrokeErrors, StrokeFit
from hitchid.live.strokes import Stroke
from hitchid.logs import ACTIVE_FRACTION, DIRECTIONS, effective_command
from hitchid.model import Channel

# Levels of the command of strokes: a plant that changed and one that lacks oil differ only at several.

# Ratio of two commands beyond the dead zone at which a speed that does not follow the command (of a starved
# pump, or behind a flow divider) differs from a lower gain by more than strokes scatter; and the quantiles of
# the samples between which it is taken. Chosen.
LEVEL_RATIO = 1.2
LOW, HIGH = 0.1, 0.9


def levels_differ(channel: Channel, strokes: Sequence[Stroke]) -> bool:
    """Return whether the commands of strokes, in one or together, have levels that differ."""
    active = np.concatenate([_active(channel, stroke) for stroke in strokes])
    if not active.size:
        return False
    low, high = np.quantile(active, [LOW, HIGH])
    return bool(high >= LEVEL_RATIO * low)


def level(channel: Channel, stroke: Stroke) -> float:
    """Return the median of a stroke's command beyond the dead zone, in its unit; 0 where it has none."""
    active = _active(channel, stroke)
    return float(np.median(active)) if active.size else 0.0


def _active(channel: Channel, stroke: Stroke) -> Float[np.ndarray, " n"]:
    """Return the command beyond the dead zone of the samples at which it is active."""
    column, highest = DIRECTIONS.index(channel.direction), float(channel.operating_range.command.highest)
    effective = np.abs(effective_command(stroke.commands[:, column], channel.dead_zone))
    return effective[effective > ACTIVE_FRACTION * highest]


# Factor on the half width of a band that keeps its coverage while the machine changes.

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
        """Return the factor after one more stroke, with e (`outside`) and α, one minus the coverage."""
        return BandFactor(float(np.clip(self.log + RATE * (outside - expected), -LARGEST, LARGEST)))


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
        # Bounded, so that no single stroke decides.
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


# What the strokes of one channel say of its parameters: fits of one stroke, and of the window.

# Standard deviations of log gain and log lag, and of the dead zone as a share of the command, of a machine
# that changed suddenly: implement and oil change its speed, hardly its valve. Chosen.
WIDE = (0.3, 0.01, 0.1)
LARGEST_DEVIATION = 1.25  # of a parameter that is known, over its scatter from stroke to stroke; chosen
STROKES_AT_ONE_LEVEL = 4  # after which an operator is taken to use no other command; chosen


class ChannelEstimates:
    """Estimates of the changes of one channel.

    From the standard deviations of the identified log gain, dead zone and log lag; each number of free runs
    at once is compiled once.

    Attributes:
        identified, wide: covariances of the changes as identified, and after a sudden change.
    """

    def __init__(self, errors: StrokeErrors, bounds: Bounds, identified: Sequence[float], runs: int) -> None:
        self._errors, self._bounds, self._runs = errors, bounds, runs
        self._noise = float(errors.channel.load_filter.noise)
        command = float(errors.channel.operating_range.command.highest)
        self.wide = np.diag((np.array([1.0, command, 1.0]) * WIDE) ** 2)
        # An identification that is sure of itself beyond what strokes scatter would never move.
        self.identified = np.diag(np.maximum(identified, 2 * bounds.scatter) ** 2)

    def own_changes(self, state: ChannelState, stroke: Stroke) -> list[Changes]:
        """Return changes that fit one stroke: of the gain, and of all parameters it informs about."""
        bounds = self._bounds
        # As many runs as a stroke is judged by, though one would do: the program is there.
        run = self._errors.runs(stroke, [state.deployed] * self._runs)
        travel = run.displacement[0] - run.displacement[0][0]
        measured = np.where(run.measured, travel + run.errors[0], 0.0)
        factor = measured @ travel / max(float((travel * run.measured) @ travel), np.finfo(float).tiny)
        gain = np.log(np.clip(factor, np.exp(bounds.lowest[GAIN]), np.exp(bounds.highest[GAIN])))
        # First the gain in closed form, as far off the linearisation would not hold.
        start = Changes(*np.add(state.deployed, [gain, 0.0, 0.0]))
        (fit,) = self._errors.fits([stroke], start)
        fit = fit.over(self.variance(state, fit.travel))
        free, wide = bounds.allowed, np.linalg.inv(self.wide)
        # With a wide prior: what one stroke does not tell stays near what is in use.
        information = np.where(np.outer(free, free), fit.information, 0.0) + wide
        gradient = np.where(free, fit.gradient, 0.0) - wide @ (fit.at - np.array(state.deployed))
        own = fit.at + np.where(free, np.linalg.solve(information, gradient), 0.0)
        return [start, Changes(*map(float, own))]

    def variance(self, state: ChannelState, travel: float) -> float:
        """Return the variance of the errors of a stroke: of the sensor, and of the usual misfit."""
        return self._noise**2 + (state.misfit * travel) ** 2

    def scattered(self, state: ChannelState, fits: Sequence[StrokeFit]) -> list[StrokeFit]:
        """Return fits over the variance of their errors: of sensor, usual misfit, and each stroke's own."""
        scatter = np.diag((state.scatter * self._bounds.scatter) ** 2)
        return [with_scatter(fit.over(self.variance(state, fit.travel)), scatter) for fit in fits]

    def of_window(
        self, state: ChannelState, strokes: Sequence[Numbered], arrival: Estimate
    ) -> tuple[Estimate, Estimate]:
        """Return the estimate after the strokes of a window, and after its first; see `window_estimate`."""

        def fits_at(mean: np.ndarray) -> list[StrokeFit]:
            changes = Changes(*map(float, mean))
            return self.scattered(state, self._errors.fits([stroke for _, stroke in strokes], changes))

        return window_estimate(fits_at, arrival, np.diag(self._bounds.drift**2), self._bounds.allowed)

    def known(self, state: ChannelState, estimate: Estimate) -> Vector:
        """Return the gain, and what else the strokes tell closely; the other parameters are as promoted.

        At one level of command gain and dead zone have the same effect: there the dead zone is not known.
        """
        deviations = np.sqrt(np.diag(estimate.covariance))
        known = deviations < LARGEST_DEVIATION * state.scatter * self._bounds.scatter
        known[GAIN] = True  # it always moves, as it fits best beside the others as promoted
        return conditional_mean(estimate, known & self._bounds.allowed, np.array(state.target))

    def cautious(self, state: ChannelState, strokes: Sequence[Numbered], changes: Vector) -> Vector:
        """Return changes, or half the way to them where they are those of the gain at several commands.

        Which gain is best without the right dead zone depends on the commands, and the next ones may be
        others than those of the strokes so far.
        """
        levels = [level(self._errors.channel, stroke) for _, stroke in strokes]
        alike = len(levels) >= STROKES_AT_ONE_LEVEL and max(levels) < LEVEL_RATIO * min(levels)
        if alike or changes[DEAD_ZONE] != state.target.dead_zone:
            return changes
        return 0.5 * (changes + np.array(state.target))
