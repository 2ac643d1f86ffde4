"""How long work tells where it stands."""

from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from types import MappingProxyType
from typing import NamedTuple


class ProgressUpdate(NamedTuple):
    """Where long work stands.

    Attributes:
        stage: what is being done.
        fraction: of all work that is done.
        iteration: how far the stage is, as `iteration 40`; empty where it has no rounds.
        figures: what the stage makes smaller, name to its value now.
        task: which of several works done at the same time tells; empty where there is one.
    """

    stage: str
    fraction: float
    iteration: str = ""
    figures: Mapping[str, float] = MappingProxyType({})
    task: str = ""


ProgressCallback = Callable[[ProgressUpdate], None]
IterationCallback = Callable[[int, float], None]
"""Called after a round of a search with its number and the best error so far."""


TYPICAL_ITERATIONS = 100  # after which half of a search's share of the progress is shown


def silent(_: ProgressUpdate) -> None:
    """Tell nobody."""


def subtask_progress(
    progress: ProgressCallback, start: float, width: float, name: str = ""
) -> ProgressCallback:
    """Return what tells of a part of the work as of the whole.

    Args:
        progress: of the whole.
        start, width: where the part begins and how much of the whole it is, fractions.
        name: put before each stage.
    """

    def report(step: ProgressUpdate) -> None:
        stage = f"{name}: {step.stage}" if name else step.stage
        progress(step._replace(stage=stage, fraction=start + width * step.fraction))

    return report


def parallel_progress(
    progress: ProgressCallback, start: float, width: float, names: Sequence[str]
) -> dict[str, ProgressCallback]:
    """Return what tells of works done at the same time, by name; they tell one after the other.

    Args:
        progress: of the whole.
        start, width: where they begin and how much of the whole they are together, fractions.
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
    """Return what tells of a search round by round.

    A search stops when it has converged, so its length is not known before: the fraction nears its end.

    Args:
        progress: of the whole.
        stage: what is searched.
        start, width: where the search begins and how much of the whole it is, fractions.
        name: of the error that is made smaller.
    """

    def report(number: int, error: float) -> None:
        fraction = start + width * number / (number + TYPICAL_ITERATIONS)
        progress(ProgressUpdate(stage, fraction, f"iteration {number}", {name: error}))

    return report
