"""Why a stroke is not learned from: what spoils a test also spoils an adaptation."""

import contextlib
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.live.parameters import DEAD_ZONE, LAG, NAMES, Changes, has_lag
from hitchid.live.settings import AdaptationSettings
from hitchid.live.stroke_errors import StrokeRuns, range_of_tests
from hitchid.live.strokes import LONGEST_S, SETTLE_S, Stroke
from hitchid.logs import DIRECTIONS, conversion_factor, effective_command
from hitchid.model import Channel, Hitch
from hitchid.structures import REST_SAMPLES

# How far and how fast the parameters of a channel may change.

MOST_DEAD_ZONE_A = 0.15  # A: change of a dead zone, whatever the range of the current is; chosen
LARGEST_LAG = 1.6  # change of the log lag: a factor of five, as oil from 5 to 50 °C has; chosen
LAG_SCATTER, LAG_DRIFT = 0.1, 0.02  # of the log lag, as the settings have for the others; chosen


@short_repr
class Bounds(NamedTuple):
    """Bounds and scales of the changes of one channel: log gain, dead zone, log lag, shape [3] each.

    Attributes:
        allowed: which parameters may change.
        lowest, highest: changes since the identification.
        step: largest change from one stroke of the machine to the next.
        scatter: standard deviation from stroke to stroke.
        drift: standard deviation by which they wander from stroke to stroke.
    """

    allowed: Bool[np.ndarray, "3"]
    lowest: Float[np.ndarray, "3"]
    highest: Float[np.ndarray, "3"]
    step: Float[np.ndarray, "3"]
    scatter: Float[np.ndarray, "3"]
    drift: Float[np.ndarray, "3"]

    @classmethod
    def of(cls, channel: Channel, settings: AdaptationSettings, command_unit: str) -> "Bounds":
        """Return the bounds of a channel; shares of the command are of the largest one of its tests."""
        command = float(channel.operating_range.command.highest)
        allowed = np.array([name in settings.parameters for name in NAMES])
        allowed[LAG] &= has_lag(channel)
        dead_zone = settings.largest_dead_zone * command
        with contextlib.suppress(InputError):  # a command that is no current
            dead_zone = min(dead_zone, MOST_DEAD_ZONE_A * conversion_factor("A", command_unit, "dead_zone"))
        lowest = np.array([np.log1p(-settings.largest_gain), -dead_zone, -LARGEST_LAG])
        lowest[DEAD_ZONE] = max(lowest[DEAD_ZONE], -channel.dead_zone)  # a dead zone is not negative
        step = settings.change_per_stroke
        return cls(
            allowed,
            lowest,
            np.array([np.log1p(settings.largest_gain), dead_zone, LARGEST_LAG]),
            np.array([np.log1p(step), step * command, step]),
            np.array([settings.gain_scatter, settings.dead_zone_scatter * command, LAG_SCATTER]),
            np.array([settings.gain_drift, settings.dead_zone_drift * command, LAG_DRIFT]),
        )

    def beyond(self, changes: Float[np.ndarray, "3"]) -> str:
        """Return the name of a parameter that is outside its bounds; empty for none."""
        outside = (changes < self.lowest) | (changes > self.highest)
        return NAMES[int(np.argmax(outside))].replace("_", " ") if outside.any() else ""

    def clipped(self, changes: Float[np.ndarray, "3"]) -> Changes:
        """Return changes within the bounds."""
        return Changes(*map(float, np.clip(changes, self.lowest, self.highest)))

    def towards(self, deployed: Changes, target: Changes) -> Changes:
        """Return the changes in use one step nearer to others; these themselves where they are that near."""
        way = np.subtract(target, deployed)
        if np.all(np.abs(way) <= self.step):
            return target  # itself, bit for bit: only then are both alike
        return Changes(*map(float, np.add(deployed, np.clip(way, -self.step, self.step))))


LARGEST_MISSING = 0.1  # share of the samples of a stroke; chosen
FEWEST_SAMPLES = 10  # of a stroke that count; chosen
LEAST_REST_S = 0.1  # s at rest before a stroke; chosen
MEDIAN_OF_NORMAL = 0.6745  # median of the size of a normal variable, standard deviations
NOISE_LIMIT = 8.0  # standard deviations of the sensor between two samples; chosen
COMMAND_MARGIN = 0.05  # share of the range of commands beyond which a command is outside it; chosen
STANDSTILL_S, STANDSTILL_SHARE = 0.4, 0.1  # s, and share of the simulated travel over it; chosen
STOP_MARGIN = 0.02  # share of the way between the limits; chosen
REST_SHARE = 0.002  # share of the range of displacements that counts as rest, whatever the noise; chosen
# Share of the travel that is left as error after gain and dead zone are fitted: multiple of what is usual,
# and the largest. Chosen.
MISFIT_FACTOR, LARGEST_MISFIT = 3.0, 0.1
SPEED_LIMIT = 0.5  # share of the fastest simulated motion by which a sample may differ from it; chosen


@short_repr
@dataclass(frozen=True)
class Gate:
    """The checks of one channel.

    Attributes:
        channel: as identified.
        step_s: sampling time of the strokes, s.
        settings: of the adaptation.
    """

    channel: Channel
    step_s: float
    settings: AdaptationSettings

    @property
    def least_rest(self) -> float:
        """Change of the displacement that counts as none, whatever the noise, in the model's unit."""
        return REST_SHARE * range_of_tests(self.channel)

    def refusal(self, stroke: Stroke) -> str:
        """Return why a stroke cannot be judged, from its samples alone; empty where it can."""
        measured = np.isfinite(stroke.displacement)
        missing = 1 - measured.mean()
        if missing > LARGEST_MISSING:  # first: what follows needs samples
            return f"{100 * missing:.0f} % of the displacement is missing"
        rest = stroke.displacement[: stroke.rest][measured[: stroke.rest]]
        noise = max(float(self.channel.load_filter.noise), np.finfo(float).tiny)
        if len(rest) < max(2, round(LEAST_REST_S / self.step_s)):
            return "it does not start at rest"
        # Its halves by their means: a drift shows, the noise of single samples does not.
        half = len(rest) // 2
        moved = abs(rest[half:].mean() - rest[:half].mean())
        if moved > max(NOISE_LIMIT * noise / np.sqrt(half), self.least_rest):
            return f"it does not start at rest: {moved:.3g} in {len(rest)} samples before the command"
        displacement = stroke.displacement[measured]
        # No motion puts a sample outside of both its neighbours; a spike does.
        inner, neighbours = displacement[1:-1], np.sort([displacement[:-2], displacement[2:]], axis=0)
        outside = float(np.abs(inner - np.clip(inner, *neighbours)).max(initial=0.0))
        limit = max(NOISE_LIMIT * np.sqrt(2) * max(noise, _noise(displacement)), self.least_rest)
        if outside > limit:
            return f"a sample lies {outside:.3g} outside of both its neighbours"
        travel = float(np.ptp(displacement))
        if travel < self.settings.shortest_travel * range_of_tests(self.channel):
            return f"the travel is too short: {travel:.3g}"
        command = stroke.commands[:, DIRECTIONS.index(self.channel.direction)]
        highest = float(self.channel.operating_range.command.highest)
        largest = float(np.abs(effective_command(command, self.channel.dead_zone)).max())
        if largest > (1 + COMMAND_MARGIN) * highest:
            return f"the command is outside the identified range: {largest:.3g} beyond the dead zone"
        if (limits := self.channel.limits) is not None:
            # Beyond a stop there is no motion to learn from, only the error of its place.
            margin = STOP_MARGIN * (limits.upper - limits.lower)
            lowest, highest = limits.lower - margin, limits.upper + margin
            if displacement.min() < lowest or displacement.max() > highest:
                return f"it leaves the range of the logs, {lowest:.4g} to {highest:.4g}"
        return ""

    def misfit(self, runs: StrokeRuns, own: int, usual: float) -> str:
        """Return why a stroke is no motion of this plant, whatever its gain and dead zone; empty where it is.

        Run number `own` has those of the stroke; `usual` is the share of the travel usually left as error.
        """
        keep = np.flatnonzero(runs.measured)
        shortest = self.settings.shortest_travel * range_of_tests(self.channel)
        if keep.size < FEWEST_SAMPLES or np.ptp((runs.displacement + runs.errors)[own][keep]) < shortest:
            return "the travel before the end stop is too short"
        simulated, errors = runs.displacement[own][keep], runs.errors[own][keep]
        measured = simulated + errors
        # Neighbouring errors differ by the sensor's noise; the median keeps spikes and jumps out.
        apart = float(np.median(np.abs(np.diff(errors)))) / (MEDIAN_OF_NORMAL * np.sqrt(2))
        noise = max(float(self.channel.load_filter.noise), apart)
        steps, expected = np.diff(measured), np.diff(simulated)
        if (measured[-1] - measured[0]) * (simulated[-1] - simulated[0]) <= 0:
            return "it moves against its command"
        # Of its fastest motion and the noise of two samples: whatever moves so fast within one is the sensor.
        limit = SPEED_LIMIT * np.abs(expected).max() + NOISE_LIMIT * np.sqrt(2) * noise
        if np.abs(steps - expected).max() > limit:
            return f"the displacement jumps by {np.abs(steps - expected).max():.3g} within a sample"
        # A stuck sensor or an end stop: no motion over a while in which the model moves.
        width = max(2, round(STANDSTILL_S / runs.step_s))
        modelled = np.abs(simulated[width:] - simulated[:-width])
        seen = np.abs(measured[width:] - measured[:-width])
        if np.any((modelled > 2 * NOISE_LIMIT * noise) & (seen < STANDSTILL_SHARE * modelled)):
            return "the displacement stands still while the model moves"
        left = runs.share_left(own)
        # Over what is usual here, so that a coarse model does not have all of its strokes refused.
        limit = min(MISFIT_FACTOR * usual, LARGEST_MISFIT)
        if left > np.hypot(limit, 2 * noise / max(float(np.ptp(simulated)), noise)):
            return f"{100 * left:.2g} % of the travel are left as error after gain and dead zone are fitted"
        return ""


def _noise(displacement: Float[np.ndarray, " n"]) -> float:
    """Return the standard deviation of the sensor's noise, from second differences; 0 of less than three."""
    second = np.abs(np.diff(displacement, 2))
    # A second difference of white noise has the variance 1 + 4 + 1 of it; the median keeps spikes out.
    return float(np.median(second)) / (MEDIAN_OF_NORMAL * np.sqrt(6)) if second.size else 0.0


# Standstill between two strokes: a jump of the displacement is a fault, a slow change a leak.

LARGEST_AT_REST = 0.05  # share of the range of the tests that a piston at rest moves within a second; chosen
LARGEST_CREEP = 0.02  # of that for each second of a pause: an implement sinks; chosen
SHORTEST_S = 10.0  # s of a standstill that shows a leak, not the end of the motion before it; chosen


@short_repr
class Standstill(NamedTuple):
    """What the displacement does between two strokes.

    Attributes:
        seconds: of it, s.
        change: of the displacement over it, between medians of samples at rest, in the model's unit.
        change_at_end: the same to the last sample before the command.
        deviation: standard deviation of the change, of noise and of what is not at rest yet.
    """

    seconds: float
    change: float
    change_at_end: float
    deviation: float

    @property
    def leak(self) -> dict[str, float]:
        """Speed of the held piston and its standard deviation, in its unit/s; none of a short standstill."""
        if self.seconds < SHORTEST_S:
            return {}
        return {"leak": self.change / self.seconds, "leak_deviation": self.deviation / self.seconds}

    def fault(self, model: Hitch) -> str:
        """Return why the displacement is not that of a held piston, which drifts; empty where it is."""
        largest = LARGEST_AT_REST * _range_of_tests(model) * (1 + LARGEST_CREEP * self.seconds)
        moved = self.change_at_end - model.drift * self.seconds  # creep that was identified is no fault
        reason = f"the displacement changed by {moved:+.3g} at rest: sensor or implement"
        return reason if abs(moved) > largest else ""


def rested_at(stroke: Stroke, step_s: float) -> float:
    """Return where the piston is at rest after a stroke; NaN where that is not in it."""
    rested = stroke.displacement[-_samples(step_s) :]
    rested = rested[np.isfinite(rested)]
    # Of a stroke that was cut at its longest, the last samples are not those at rest.
    if not rested.size or len(stroke.displacement) >= round(LONGEST_S / step_s):
        return math.nan
    return float(np.median(rested))


def standstill_before(model: Hitch, stroke: Stroke, ended_at: int, rested: float) -> Standstill | None:
    """Return the standstill before a stroke; None where it was not seen.

    The stroke before ended at the sample of number `ended_at`, where the piston `rested`; NaN: not known.
    """
    before = stroke.displacement[: stroke.rest]
    before = before[np.isfinite(before)]
    if not before.size or math.isnan(rested):
        return None
    samples = _samples(model.step_s)
    noise = max(float(channel.load_filter.noise) for channel in model.channels.values())
    # A median of n normal variables has the variance π/2 σ²/n.
    deviation = np.hypot(noise * np.sqrt(np.pi / samples), REST_SHARE * _range_of_tests(model))
    return Standstill(
        max(stroke.begin - ended_at, 0) * model.step_s,
        float(np.median(before[-samples:])) - rested,  # one wrong sample is no leak
        float(before[-1]) - rested,
        float(deviation),
    )


def _samples(step_s: float) -> int:
    """Return how many samples show where the piston is at rest."""
    return min(REST_SAMPLES // 5, max(1, round(SETTLE_S / step_s)))


def _range_of_tests(model: Hitch) -> float:
    return max(map(range_of_tests, model.channels.values()))
