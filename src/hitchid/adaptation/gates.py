"""Why a stroke is not learned from: what spoils a test also spoils an adaptation."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.settings import AdaptationSettings
from hitchid.adaptation.stroke_errors import StrokeRuns
from hitchid.adaptation.strokes import Stroke
from hitchid.data.record import DIRECTIONS
from hitchid.data.test_kinds import effective_command
from hitchid.model import Channel

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
    def range_of_tests(self) -> float:
        """Range of the displacement in the identification tests, in the model's unit."""
        covered = self.channel.operating_range.displacement
        return float(covered.highest) - float(covered.lowest)

    @property
    def least_rest(self) -> float:
        """Change of the displacement that counts as none, whatever the noise, in the model's unit."""
        return REST_SHARE * self.range_of_tests

    def refusal(self, stroke: Stroke) -> str:
        """Return why a stroke cannot be judged, from its samples alone; empty where it can."""
        return next(self._refusals(stroke), "")

    def _refusals(self, stroke: Stroke) -> Iterator[str]:
        measured = np.isfinite(stroke.displacement)
        missing = 1 - measured.mean()
        if missing > LARGEST_MISSING:
            yield f"{100 * missing:.0f} % of the displacement is missing"
        rest = stroke.displacement[: stroke.rest][measured[: stroke.rest]]
        noise = max(float(self.channel.load_filter.noise), np.finfo(float).tiny)
        if len(rest) < max(2, round(LEAST_REST_S / self.step_s)):
            yield "it does not start at rest"
            return
        half = len(rest) // 2
        moved = abs(rest[half:].mean() - rest[:half].mean())
        if moved > max(NOISE_LIMIT * noise / np.sqrt(half), self.least_rest):
            yield f"it does not start at rest: {moved:.3g} in {len(rest)} samples before the command"
        displacement = stroke.displacement[measured]
        outside = _farthest_outside(displacement)
        limit = max(NOISE_LIMIT * np.sqrt(2) * max(noise, _noise(displacement)), self.least_rest)
        if outside > limit:
            yield f"a sample lies {outside:.3g} outside of both its neighbours"
        travel = float(np.ptp(displacement))
        if travel < self.settings.shortest_travel * self.range_of_tests:
            yield f"the travel is too short: {travel:.3g}"
        command = stroke.commands[:, DIRECTIONS.index(self.channel.direction)]
        highest = float(self.channel.operating_range.command.highest)
        largest = float(np.abs(effective_command(command, self.channel.dead_zone)).max())
        if largest > (1 + COMMAND_MARGIN) * highest:
            yield f"the command is outside the identified range: {largest:.3g} beyond the dead zone"
        limits = channel_limits(self.channel)
        if displacement.min() < limits[0] or displacement.max() > limits[1]:
            yield f"it leaves the range of the logs, {limits[0]:.4g} to {limits[1]:.4g}"

    def misfit(self, runs: StrokeRuns, own: int, usual: float) -> str:
        """Return why a stroke is no motion of this plant, whatever its gain and dead zone; empty where it is.

        Args:
            runs: free runs of the stroke, with those of its own gain and dead zone.
            own: number of that run.
            usual: share of the travel that is usually left as error.
        """
        return next(self._misfits(runs, own, usual), "")

    def _misfits(self, runs: StrokeRuns, own: int, usual: float) -> Iterator[str]:
        keep = np.flatnonzero(runs.measured)
        shortest = self.settings.shortest_travel * self.range_of_tests
        if keep.size < FEWEST_SAMPLES or np.ptp((runs.displacement + runs.errors)[own][keep]) < shortest:
            yield "the travel before the end stop is too short"
            return
        simulated, errors = runs.displacement[own][keep], runs.errors[own][keep]
        measured = simulated + errors
        # Neighbouring errors differ by the sensor's noise; the median keeps spikes and jumps out.
        apart = float(np.median(np.abs(np.diff(errors)))) / (MEDIAN_OF_NORMAL * np.sqrt(2))
        noise = max(float(self.channel.load_filter.noise), apart)
        steps, expected = np.diff(measured), np.diff(simulated)
        if (measured[-1] - measured[0]) * (simulated[-1] - simulated[0]) <= 0:
            yield "it moves against its command"
        limit = SPEED_LIMIT * np.abs(expected).max() + NOISE_LIMIT * np.sqrt(2) * noise
        if np.abs(steps - expected).max() > limit:
            yield f"the displacement jumps by {np.abs(steps - expected).max():.3g} within a sample"
        yield from self._standstill(measured, simulated, noise, runs.step_s)
        left = runs.share_left(own)
        limit = min(MISFIT_FACTOR * usual, LARGEST_MISFIT)
        if left > np.hypot(limit, 2 * noise / max(float(np.ptp(simulated)), noise)):
            yield f"{100 * left:.2g} % of the travel are left as error after gain and dead zone are fitted"

    def _standstill(
        self,
        measured: Float[np.ndarray, " n"],
        simulated: Float[np.ndarray, " n"],
        noise: float,
        step_s: float,
    ) -> Iterator[str]:
        """Stuck sensor or end stop: no motion over a while in which the model moves."""
        width = max(2, round(STANDSTILL_S / step_s))
        if len(measured) <= width:
            return
        expected = np.abs(simulated[width:] - simulated[:-width])
        seen = np.abs(measured[width:] - measured[:-width])
        stands = (expected > 2 * NOISE_LIMIT * noise) & (seen < STANDSTILL_SHARE * expected)
        if stands.any():
            yield "the displacement stands still while the model moves"


def _farthest_outside(displacement: Float[np.ndarray, " n"]) -> float:
    """Return how far a sample lies outside of both its neighbours at most: no motion does that, a spike does.

    Args:
        displacement: measured, without gaps, shape [N].
    """
    inner = displacement[1:-1]
    between = np.clip(inner, *np.sort([displacement[:-2], displacement[2:]], axis=0))
    return float(np.abs(inner - between).max(initial=0.0))


def _noise(displacement: Float[np.ndarray, " n"]) -> float:
    """Return the standard deviation of the sensor's noise, from second differences; 0 of less than three."""
    second = np.abs(np.diff(displacement, 2))
    # A second difference of white noise has the variance 1 + 4 + 1 of it; the median keeps spikes out.
    return float(np.median(second)) / (MEDIAN_OF_NORMAL * np.sqrt(6)) if second.size else 0.0


def channel_limits(channel: Channel) -> tuple[float, float]:
    """Return lowest and highest displacement at which strokes are learned from, a margin beyond stops.

    Beyond a stop that was met there is no motion that could be learned from, only the error of its place.
    """
    if channel.limits is None:
        return -np.inf, np.inf
    margin = STOP_MARGIN * (channel.limits.upper - channel.limits.lower)
    return channel.limits.lower - margin, channel.limits.upper + margin
