"""A model beside the best of its rivals on the same unseen tests."""

from hitchid._support.metrics import SIGNIFICANCE
from hitchid.validation import Accuracy
from hitchid.validation.results import BENCHMARK, GREYBOX

BETTER, WORSE, ALIKE, SINGLE = "better", "worse", "not distinguishable", "one test: no standard error"


def best_rival(accuracy: Accuracy) -> str | None:
    """Return the baseline with the smallest RMSE in free run; None where none has one."""
    errors = {
        name: figures.free_run.rmse
        for name, figures in accuracy.models.items()
        if name not in (BENCHMARK, GREYBOX) and figures.free_run is not None and figures.free_run.rmse
    }
    return min(errors, key=lambda name: errors[name], default=None)


def difference(accuracy: Accuracy, rival: str) -> str:
    """Return whether the model is better or worse in free run, at 5 %, two-sided, tests being independent."""
    tests = accuracy.predictions
    if len(tests.names) < 2:
        return SINGLE
    if tests.better_p_value("free_run", rival) < SIGNIFICANCE:
        return BETTER
    return WORSE if tests.better_p_value(rival, "free_run") < SIGNIFICANCE else ALIKE
