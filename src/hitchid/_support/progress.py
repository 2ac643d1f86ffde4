"""Progress of long work, reported by callbacks."""

from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from types import MappingProxyType
from typing import NamedTuple


class ProgressUpdate(NamedTuple):
    """One report of progress.

    Attributes:
        stage: name of the present stage.
        fraction: completed share of all work.
        iteration: such as `iteration 40`; empty where the stage has none.
        figures: name to present value of what the stage minimises.
        task: which of several parallel tasks reports; empty where there is one.
    """

    stage: str
    fraction: float
    iteration: str = ""
    figures: Mapping[str, float] = MappingProxyType({})
    task: str = ""


ProgressCallback = Callable[[ProgressUpdate], None]
IterationCallback = Callable[[int, float], None]
"""Called after an iteration of a search with its number and the best error so far."""


TYPICAL_ITERATIONS = 100  # after which half of a search's share of the progress is shown


def silent(_: ProgressUpdate) -> None:
    """Report nothing."""


def subtask_progress(
    progress: ProgressCallback, start: float, width: float, name: str = ""
) -> ProgressCallback:
    """Return a callback that reports the progress of a part as progress of the whole.

    Args:
        progress: of the whole.
        start, width: where the part begins, and its share of the whole, fractions.
        name: put before each stage.
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
        start, width: where they begin, and their share of the whole together, fractions.
        names: put before each stage.
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
        start, width: where the search begins, and its share of the whole, fractions.
        name: of the error that is minimised.
    """

    def report(number: int, error: float) -> None:
        fraction = start + width * number / (number + TYPICAL_ITERATIONS)
        progress(ProgressUpdate(stage, fraction, f"iteration {number}", {name: error}))

    return report
