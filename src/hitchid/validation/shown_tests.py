"""Tests that a figure shows."""

import numpy as np

from hitchid.validation.predictions import Predictions

MAX_SHOWN_TESTS = 4  # tests in one figure; chosen, so that curves stay distinguishable


def shown_tests(tests: Predictions, model: str = "free_run") -> tuple[Predictions, str]:
    """Return at most four tests, from the best to the worst, and a text on their selection."""
    count = len(tests.names)
    if count <= MAX_SHOWN_TESTS:
        return tests, "all unseen tests"
    order = np.argsort(tests.rmse(model))
    selected = sorted(
        {int(order[round(position)]) for position in np.linspace(0, count - 1, MAX_SHOWN_TESTS)}
    )
    best, worst = tests.names[order[0]], tests.names[order[-1]]
    selection = f"{len(selected)} of {count} unseen tests, {best} the best, {worst} the worst"
    return tests.take(selected), selection
