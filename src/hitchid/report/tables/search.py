"""Table of searches compared with equal budgets."""

from collections.abc import Sequence

import numpy as np

from hitchid.model import SearchSummary
from hitchid.report import numbers
from hitchid.report.document import Table


def search_table(direction: str, searches: Sequence[SearchSummary], unit: str) -> Table:
    """Return the final errors of several searches, best first."""
    ends = {
        search.name: np.array([np.inf if end is None else end for end in search.rmse]) for search in searches
    }
    best = min(float(errors.min()) for errors in ends.values())
    medians = {name: float(np.median(errors)) for name, errors in ends.items()}
    ordered = sorted(searches, key=lambda search: (medians[search.name], float(ends[search.name].max())))
    rows = tuple(
        (
            search.name,
            f"{medians[search.name]:.5g}",
            f"{ends[search.name].max():.5g}",
            numbers.percent(medians[search.name] / best - 1, 2),
            f"{np.sum(ends[search.name] <= 1.01 * best)} of {len(search.rmse)}",
            f"{np.mean(search.evaluations):.0f}",
            str(sum(search.failures)),
        )
        for search in ordered
    )
    header = (
        "search, best first",
        f"median RMSE / {unit}",
        f"worst seed / {unit}",
        "median above the best / %",
        "seeds within 1 % of the best",
        "evaluations",
        "failed",
    )
    return Table(f"{direction}: searches with equal evaluations, before least squares", header, rows)
