"""Are faulty machines named, and sound ones not? Fleets of 200 simulated machines, 5 of them faulty.

A machine has the logarithm of a gain and a dead zone. Sound ones are normally distributed about the mean; a
faulty one has 10 % more or less gain, or a dead zone 0.03 A larger or smaller, besides its own deviation.
A discovery is a pair of machine and parameter; it is false unless this machine is faulty in this parameter.
Prints a Markdown table, a row for each spread; exits with 1 if a bar is missed at the first one.

Run: python -m benchmarks.fleet_outliers
"""

import sys
from typing import NamedTuple

import numpy as np

from hitchid.fleet.outliers import Outliers, find_outliers

FLEETS, MACHINES, FAULTS = 50, 200, 5
GAIN_FAULT, DEAD_ZONE_FAULT = 0.1, 0.03  # of the gain; A
# Standard errors of the estimates, uniform between two numbers as campaigns differ. A gain of the bench rig-a
# has 0.9 % (docs/uncertainty.md); for a dead zone chosen, above the 1.2 mA of three ramps in coverage.py.
GAIN_ERRORS, DEAD_ZONE_ERRORS = (0.005, 0.015), (0.0015, 0.0045)  # relative; A
CORRELATION = 0.6  # of both errors, chosen: a larger gain makes up for a larger dead zone
# Standard deviations of gain, relative, and dead zone, A, over sound machines; the bars hold at the first.
# Chosen: valves of one type, set at the factory; the others are one and a half times and twice as wide.
SPREADS = ((0.01, 0.003), (0.015, 0.0045), (0.02, 0.006))
FALSE_DISCOVERY_RATE = 0.1  # level of the procedure, and the bar of its mean over fleets
SEED = 27


class Figures(NamedTuple):
    """Faults named, discoveries, false ones and their share; median detectable gain and dead zone."""

    named: int
    discoveries: int
    false: int
    false_share: float
    detectable: tuple[float, float]


def simulated(
    spread: tuple[float, float], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return estimates, covariances of their errors, and which machine is faulty in which parameter."""
    faulty = np.zeros((MACHINES, 2), bool)
    machines = rng.choice(MACHINES, FAULTS, replace=False)
    faulty[machines, rng.integers(0, 2, FAULTS)] = True
    larger = rng.integers(0, 2, faulty.shape).astype(bool)
    gain_fault = np.where(larger[:, 0], np.log1p(GAIN_FAULT), np.log1p(-GAIN_FAULT))
    dead_zone_fault = np.where(larger[:, 1], DEAD_ZONE_FAULT, -DEAD_ZONE_FAULT)
    truth = rng.standard_normal((MACHINES, 2)) * spread + faulty * np.stack(
        [gain_fault, dead_zone_fault], axis=1
    )
    deviations = np.stack([rng.uniform(*ends, MACHINES) for ends in (GAIN_ERRORS, DEAD_ZONE_ERRORS)], axis=1)
    shape = np.array([[1.0, CORRELATION], [CORRELATION, 1.0]])
    noise = deviations * (rng.standard_normal((MACHINES, 2)) @ np.linalg.cholesky(shape).T)
    return truth + noise, deviations[:, :, None] * shape * deviations[:, None, :], faulty


def figures(found: Outliers, faulty: np.ndarray) -> Figures:
    """Return the figures of one fleet."""
    discoveries, false = int(found.named.sum()), int((found.named & ~faulty).sum())
    gain, dead_zone = np.median(found.detectable, axis=0).tolist()
    return Figures(
        int((found.named & faulty).sum()), discoveries, false, false / max(1, discoveries), (gain, dead_zone)
    )


def study(spread: tuple[float, float]) -> tuple[float, float]:
    """Print a row; return the share of faults that were named and the mean share of false discoveries."""
    rng, results = np.random.default_rng(SEED), []
    for _ in range(FLEETS):
        estimates, covariances, faulty = simulated(spread, rng)
        found = find_outliers(estimates, covariances, false_discovery_rate=FALSE_DISCOVERY_RATE)
        results.append(figures(found, faulty))
    named = sum(each.named for each in results) / (FLEETS * FAULTS)
    false_share = float(np.mean([each.false_share for each in results]))
    gain, dead_zone = np.median([each.detectable for each in results], axis=0)
    counts = f"{sum(each.false for each in results)} of {sum(each.discoveries for each in results)}"
    cells = (
        f"{100 * spread[0]:g} %, {1000 * spread[1]:g} mA",
        f"{sum(each.named for each in results)} of {FLEETS * FAULTS}",
        counts,
        f"{100 * false_share:.1f} %",
        f"{100 * gain:.1f} %, {1000 * dead_zone:.0f} mA",
    )
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    return named, false_share


def main() -> None:
    """Print the table; exit with 1 if a bar is missed at the first spread."""
    titles = ("spread of sound machines", "faults named", "false discoveries", "mean share", "detectable")
    sys.stdout.write(f"| {' | '.join(titles)} |\n| --- | ---: | ---: | ---: | ---: |\n")
    (named, false_share), *_ = [study(spread) for spread in SPREADS]
    if named < 1 or false_share > FALSE_DISCOVERY_RATE:
        sys.exit(
            f"missed: {100 * named:.1f} % of the faults named, {100 * false_share:.1f} % false discoveries"
        )


if __name__ == "__main__":
    main()
