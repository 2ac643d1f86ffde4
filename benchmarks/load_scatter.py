"""Does the 95 % interval of the load's scatter hold the truth? Simulated campaigns of known scatter.

Plants, tests and errors are those of `coverage.py`; each test has a factor exp(b) on its speed, b ~ N(0, ω²).
The form is given. Prints a Markdown table: how often the interval of ω holds it, its median estimate, how
often it is called determined, and how often the interval of a test's own value holds that of the test.

    python benchmarks/load_scatter.py [CAMPAIGNS] [PLANT]
"""

import sys

import jax
import numpy as np
from coverage import (
    DEAD_ZONE_A,
    DEAD_ZONE_SPREAD_A,
    PLANTS,
    SEARCH,
    TESTS,
    Plant,
    make_test,
    percent,
    write_row,
)

from hitchid.identification.phase1 import find_parameters
from hitchid.logs.record import LIFTING
from hitchid.model import LoadScatter
from hitchid.structures import Batch
from hitchid.uncertainty import load_scatter

SCATTERS = (0.0, 0.015, 0.04)
AT_BOUND = 1e-6  # of the unit cube; a parameter closer to a bound counts as being there


def identified(plant: Plant, scatter: float, seed: int) -> tuple[LoadScatter, np.ndarray]:
    """Return the scatter found in one simulated campaign, and the truth of each test."""
    rng = np.random.default_rng(seed)
    loads = scatter * rng.spawn(1)[0].standard_normal(TESTS)
    records = [make_test(plant, rng, number, float(np.exp(load))) for number, load in enumerate(loads)]
    dead_zone = float((DEAD_ZONE_A + DEAD_ZONE_SPREAD_A * rng.standard_normal(3)).mean())
    batch = Batch.of(records, LIFTING, dead_zone=dead_zone, sign=1)
    fit = find_parameters(batch, plant.form, SEARCH, 0)
    free = (fit.position > AT_BOUND) & (fit.position < 1 - AT_BOUND)
    names = [record.name for record in records]
    return load_scatter(fit.objective, fit.position, free, names), np.expm1(loads)


def study(name: str, plant: Plant, scatter: float, campaigns: int) -> None:
    """Print a row: one plant at one scatter of the load."""
    results = [identified(plant, scatter, seed) for seed in range(campaigns)]
    covered, values, determined, own = [], [], [], []
    for found, truth in results:
        lower, upper = found.interval
        covered.append((lower or 0.0) <= scatter and (upper is None or scatter <= upper))
        values.append(found.scatter)
        determined.append(found.determined)
        own += [t.interval[0] <= b <= t.interval[1] for t, b in zip(found.tests, truth, strict=True)]
    write_row(
        name,
        f"{100 * scatter:.2g}",
        campaigns,
        percent(covered),
        f"{100 * np.median(values):.2g}",
        percent(determined),
        percent(own),
    )


def main() -> None:
    """Run every plant that was asked for, or all."""
    jax.config.update("jax_enable_x64", True)
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    write_row(
        "plant",
        "scatter / %",
        "campaigns",
        "scatter in the interval / %",
        "median estimate / %",
        "called determined / %",
        "own value in its interval / %",
    )
    sys.stdout.write(f"|{' --- |' * 7}\n")
    for name, plant in PLANTS.items():
        if name not in (sys.argv[2:] or PLANTS):
            continue
        for scatter in SCATTERS:
            study(name, plant, scatter, campaigns)


if __name__ == "__main__":
    main()
