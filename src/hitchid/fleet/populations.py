"""Distribution of parameters over the machines of a fleet: mean, spread, and where another machine lies."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from hitchid.fleet.hierarchical import FEWEST, Hierarchy, fit_hierarchy
from hitchid.fleet.parameters import FleetParameter

LEVEL = 0.95  # of the intervals


class Population(NamedTuple):
    """Distribution of one parameter over machines, of its estimates; NaN with fewer than three machines.

    Attributes:
        machines: number of machines with the parameter.
        mean: over machines.
        mean_interval: 95 % interval of the mean.
        spread: standard deviation between machines.
        spread_interval: 95 % interval of the spread.
        prediction_interval: contains the parameter of another machine with a probability of 95 %.
    """

    machines: int
    mean: float = np.nan
    mean_interval: tuple[float, float] = (np.nan, np.nan)
    spread: float = np.nan
    spread_interval: tuple[float, float] = (np.nan, np.nan)
    prediction_interval: tuple[float, float] = (np.nan, np.nan)


def hierarchies_of(
    parameters: Sequence[FleetParameter], estimates: np.ndarray, covariances: np.ndarray
) -> dict[str, tuple[tuple[int, ...], Hierarchy]]:
    """Return direction to the parameters that at least three machines have, and their model.

    Args:
        parameters: shape [P].
        estimates: shape [N, P], NaN where missing.
        covariances: of their errors, shape [N, P, P].
    """
    enough = np.sum(~np.isnan(estimates), axis=0) >= FEWEST
    hierarchies = {}
    for direction in dict.fromkeys(parameter.direction for parameter in parameters):
        columns = [
            index for index, each in enumerate(parameters) if each.direction == direction and enough[index]
        ]
        if columns:
            fit = fit_hierarchy(*selected(estimates, covariances, np.array(columns)))
            hierarchies[direction] = (tuple(columns), fit)
    return hierarchies


def populations_of(
    estimates: np.ndarray, hierarchies: Mapping[str, tuple[tuple[int, ...], Hierarchy]]
) -> tuple[Population, ...]:
    """Return the distribution of each parameter.

    A further machine lies within μ ± t √(τ² + Var μ), with n − 1 degrees of freedom.

    Source: Partlett & Riley 2017, Random effects meta-analysis: coverage performance of 95 % confidence and
        prediction intervals.
    """
    counts = np.sum(~np.isnan(estimates), axis=0)
    populations = [Population(int(count)) for count in counts]
    for columns, fit in hierarchies.values():
        for place, column in enumerate(columns):
            mean, variance = float(fit.mean[place]), float(fit.mean_covariance[place, place])
            deviation = float(np.sqrt(fit.between[place, place] + variance))
            half_width = float(stdtrit(counts[column] - 1, (1 + LEVEL) / 2)) * deviation
            populations[column] = Population(
                int(counts[column]),
                mean,
                _ends(fit.mean_interval[place]),
                float(fit.spread[place]),
                _ends(fit.spread_interval[place]),
                (mean - half_width, mean + half_width),
            )
    return tuple(populations)


def selected(
    estimates: np.ndarray, covariances: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates and covariances of some of the parameters."""
    return estimates[:, columns], covariances[:, columns[:, None], columns]


def _ends(interval: np.ndarray) -> tuple[float, float]:
    return float(interval[0]), float(interval[1])
