"""What the strokes of one channel say of its parameters: fits of one stroke, and of the window."""

from collections.abc import Sequence

import numpy as np

from hitchid.adaptation.bounds import Bounds
from hitchid.adaptation.channel_state import ChannelState, Numbered
from hitchid.adaptation.estimator import Estimate, Vector, conditional_mean, window_estimate, with_scatter
from hitchid.adaptation.levels import LEVEL_RATIO, level
from hitchid.adaptation.parameters import DEAD_ZONE, GAIN, Changes
from hitchid.adaptation.stroke_errors import StrokeErrors, StrokeFit
from hitchid.adaptation.strokes import Stroke

# Standard deviations of log gain and log lag, and of the dead zone as a share of the command, of a machine
# that changed suddenly: implement and oil change its speed, hardly its valve. Chosen.
WIDE = (0.3, 0.01, 0.1)
LARGEST_DEVIATION = 1.25  # of a parameter that is known, over its scatter from stroke to stroke; chosen
STROKES_AT_ONE_LEVEL = 4  # after which an operator is taken to use no other command; chosen


class ChannelEstimates:
    """Estimates of the changes of one channel.

    Args:
        errors: of its strokes.
        bounds: of its changes.
        identified: standard deviations of the identified parameters: log gain, dead zone, log lag.
        runs: free runs of a stroke at once; each number is compiled once.

    Attributes:
        identified, wide: covariances of the changes as identified, and after a sudden change.
    """

    def __init__(self, errors: StrokeErrors, bounds: Bounds, identified: Sequence[float], runs: int) -> None:
        self._errors, self._bounds, self._runs = errors, bounds, runs
        self._noise = float(errors.channel.load_filter.noise)
        command = float(errors.channel.operating_range.command.highest)
        self.wide = np.diag((np.array([1.0, command, 1.0]) * WIDE) ** 2)
        self.identified = np.diag(np.maximum(identified, 2 * bounds.scatter) ** 2)

    def own_changes(self, state: ChannelState, stroke: Stroke) -> list[Changes]:
        """Return changes that fit one stroke: of the gain, and of all parameters it informs about."""
        bounds = self._bounds
        run = self._errors.runs(stroke, [state.deployed] * self._runs)
        travel = run.displacement[0] - run.displacement[0][0]
        measured = np.where(run.measured, travel + run.errors[0], 0.0)
        factor = measured @ travel / max(float((travel * run.measured) @ travel), np.finfo(float).tiny)
        gain = np.log(np.clip(factor, np.exp(bounds.lowest[GAIN]), np.exp(bounds.highest[GAIN])))
        start = Changes(*np.add(state.deployed, [gain, 0.0, 0.0]))
        (fit,) = self._errors.fits([stroke], start)
        fit = fit.over(self.variance(state, fit.travel))
        free, wide = bounds.allowed, np.linalg.inv(self.wide)
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
        """Return the estimate after the strokes of a window, and that after its first; see `window_estimate`.

        Args:
            state: whose scatter and usual misfit hold.
            strokes: of the window, the oldest first.
            arrival: estimate before them.
        """

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
        known[GAIN] = True
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
