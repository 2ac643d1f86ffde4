"""Progress of long work, reported by callbacks."""

from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from types import MappingProxyType
from typing import NamedTuple


class ProgressUpdate(NamedTuple):
    """State of progress at one time.

    Attributes:
        stage: name of the present stage.
        fraction: completed share of all work.
        iteration: such as `iteration 40`; may be empty.
        figures: name to present value of the minimised quantities.
        task: name of the parallel task; empty for a single one.
    """

    stage: str
    fraction: float
    iteration: str = ""
    figures: Mapping[str, float] = MappingProxyType({})
    task: str = ""


ProgressCallback = Callable[[ProgressUpdate], None]
IterationCallback = Callable[[int, float], None]
"""Called after each iteration of a search with its number and the best error so far."""


TYPICAL_ITERATIONS = 100  # iterations at half of a search's share of the progress (chosen)


def silent(_: ProgressUpdate) -> None:
    """Ignore a progress update."""


def subtask_progress(
    progress: ProgressCallback, start: float, width: float, name: str = ""
) -> ProgressCallback:
    """Return a callback that maps the progress of a subtask to the progress of the whole.

    Args:
        progress: of the whole.
        start, width: start of the subtask and its share of the whole, fractions.
        name: prefix of each stage.
    """

    def report(step: ProgressUpdate) -> None:
        stage = f"{name}: {step.stage}" if name else step.stage
        progress(step._replace(stage=stage, fraction=start + width * step.fraction))

    return report


def parallel_progress(
    progress: ProgressCallback, start: float, width: float, names: Sequence[str]
) -> dict[str, ProgressCallback]:
    """Return a thread-safe callback for each of several parallel tasks, by name.

    Args:
        progress: of the whole.
        start, width: start of the tasks and their total share of the whole, fractions.
        names: of the tasks, prefixed to each stage.
    """
    fractions, lock = dict.fromkeys(names, 0.0), Lock()

    def reporter(name: str) -> ProgressCallback:
        def report(step: ProgressUpdate) -> None:
            with lock:
                fractions[name] = step.fraction
                fraction = start + width * sum(fractions.values()) / len(fractions)
                progress(step._replace(stage=f"{name}: {step.stage}", fraction=fraction, task=name))

        return report

    return {name: reporter(name) for name in names}


def iteration_progress(
    progress: ProgressCallback, stage: str, start: float, width: float, name: str
) -> IterationCallback:
    """Return a callback that reports the iterations of a search.

    The number of iterations until convergence is unknown, so the fraction approaches the end asymptotically.

    Args:
        progress: of the whole.
        stage: name of the search.
        start, width: start of the search and its share of the whole, fractions.
        name: of the minimised error.
    """

    def report(number: int, error: float) -> None:
        fraction = start + width * number / (number + TYPICAL_ITERATIONS)
        progress(ProgressUpdate(stage, fraction, f"iteration {number}", {name: error}))

    return report
