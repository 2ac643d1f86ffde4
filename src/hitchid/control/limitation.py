"""What limits a position controller: a parameter that its margins depend on, or the noise of its sensor."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.control.loops import SHARE, DirectionLoops, pi_gains
from hitchid.control.prediction import loads_of_channels
from hitchid.control.tuning import HIGHEST_RAD_S, LOWEST_RAD_S, check_tunable, fastest_gains, highest_rad_s
from hitchid.errors import InputError
from hitchid.logs import DIRECTIONS
from hitchid.model import PARAMETER_DRAWS, Hitch, Load

CAPPED = 0.99  # of the largest bandwidth that is searched; the search ends within a thousandth of it


@short_repr
@dataclass(frozen=True)
class Limitation:
    """What the tests of one direction leave open, as far as it limits the controller.

    Attributes:
        direction: lifting or lowering.
        bandwidth_rad_s: largest of PI control with all margins, or that at the bound of `limit`.
        limit: what ends the bandwidth: the `margins`; or before them the `noise` of the sensor, which asks
            for 4 % of the largest speed there, or the end of the `search` at 30 rad/s. Noise is as
            identified, and may contain what the model misses.
        nominal: Ms at the worst operating point with the identified parameters.
        worst: Ms that 95 % of the draws keep there.
        shares: parameter to the share of the variance of log Ms over draws that would vanish with this
            parameter known, to first order; the largest first.
    """

    direction: str
    bandwidth_rad_s: float
    limit: Literal["margins", "noise", "search"]
    nominal: float
    worst: float
    shares: Mapping[str, float]

    @property
    def parameter(self) -> str:
        """The parameter with the largest share."""
        return next(iter(self.shares))


@double_precision
def limitation(
    model: Hitch,
    direction: str | None = None,
    *,
    load: Load | None = None,
    draws: int = PARAMETER_DRAWS,
    seed: int = 0,
) -> Limitation:
    """Return what limits the controller in the direction where the parameters' spread costs Ms the most.

    A direction that its margins limit comes before one that the noise of the sensor does.

    At the largest bandwidth of PI control that keeps its margins, log Ms of a draw is correlated with each of
    its parameters over all draws; the squared correlation is the share of its variance that goes with the
    parameter. Ms bounds gain and phase margin (Skogestad & Postlethwaite 2005, sec. 2.4.3).

    Args:
        model: of both directions, sampled every 10 ms, in any units.
        direction: only this one.
        load: covariates that the controller is tuned for; their mean in the tests by default.
        draws: parameter vectors.
        seed: of the draws.

    Raises:
        InputError: the model cannot be tuned, or has no parameter with a standard error.
    """
    check_tunable(model)
    if direction is not None:
        checks.one_of(direction, DIRECTIONS, "direction")
    limitations = [
        _limitation(model, name, row, draws, seed)
        for name, row in zip(DIRECTIONS, loads_of_channels(model, load), strict=True)
        if direction in (None, name)
    ]
    return max(limitations, key=lambda own: (own.limit == "margins", own.worst / own.nominal))


def _limitation(
    model: Hitch, direction: str, row: Float[np.ndarray, " c"], draws: int, seed: int
) -> Limitation:
    loops = DirectionLoops.of(model, direction, row, draws, seed)
    fastest = fastest_gains(loops, pi_gains)
    gains = fastest or pi_gains(LOWEST_RAD_S, loops.lags, loops.step_s)
    limit = "noise" if loops.noise_rad_s < HIGHEST_RAD_S else "search"
    if fastest is None or fastest.proportional < CAPPED * highest_rad_s(loops):
        limit = "margins"
    # Of the model, then of each draw, at its worst operating point.
    sensitivity = np.max([point.sensitivity for point in loops.margins_at_points(gains)], axis=0)
    names = [parameter.name for parameter in model.channels[direction].benchmark.parameters]
    logs = np.log(np.minimum(sensitivity[1:], np.finfo(float).max))
    shares = {
        name: float(np.corrcoef(column, logs)[0, 1] ** 2)
        for name, column in zip(names, loops.vectors.T, strict=True)
        if np.ptp(column) > 0 and np.ptp(logs) > 0
    }
    if not shares:
        raise InputError(f"model: no {direction} parameter changes the margins; no test helps the controller")
    return Limitation(
        direction,
        float(gains.proportional),
        limit,
        float(sensitivity[0]),
        float(np.quantile(sensitivity[1:], SHARE)),
        dict(sorted(shares.items(), key=lambda item: -item[1])),
    )
