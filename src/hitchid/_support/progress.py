"""Progress of long work, reported by callbacks."""

from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from hitchid.errors import OutputError

Result = TypeVar("Result")

# Optional parts of a result: a part that fails is left out, with a notice.


def attempt(description: str, compute: Callable[[], Result], notices: list[str]) -> Result | None:
    """Compute an optional part of a result; where it fails, for whatever cause, it is None, with a notice.

    Raises:
        OutputError: a checkpoint cannot be written, as on a full disk.
    """
    try:
        return compute()
    # A full disk is no fault of this part: the run ends, and can be resumed.
    except OutputError:
        raise
    except Exception as error:
        cause = str(error) or "no message"
        notices.append(f"could not be computed: {description} ({type(error).__name__}: {cause})")
        return None


class ProgressUpdate(NamedTuple):
    """State of progress at one time.

    Attributes:
        stage: name of the present stage.
        fraction: completed share of all work.
        iteration: such as `iteration 40`; may be empty.
        figures: name to present value of the minimised quantities.
        task: name of the parallel task; empty for a single one.
        message: what has been reached, which stays to be read; empty for most updates.
    """

    stage: str
    fraction: float
    iteration: str = ""
    figures: Mapping[str, float] = MappingProxyType({})
    task: str = ""
    message: str = ""


ProgressCallback = Callable[[ProgressUpdate], None]
IterationCallback = Callable[[int, float], None]
"""Called after each iteration of a search with its number and the best error so far."""


TYPICAL_ITERATIONS = 100  # iterations at half of a search's share of the progress (chosen)


def silent(_: ProgressUpdate) -> None:
    """Ignore a progress update."""


def subtask_progress(
    progress: ProgressCallback, start: float, width: float, name: str = ""
) -> ProgressCallback:
    """Return a callback that maps a subtask's progress to the whole: from `start` on, a share of `width`."""

    def report(step: ProgressUpdate) -> None:
        stage = f"{name}: {step.stage}" if name else step.stage
        progress(step._replace(stage=stage, fraction=start + width * step.fraction))

    return report


def split_progress(progress: ProgressCallback, shares: Mapping[str, float]) -> dict[str, ProgressCallback]:
    """Return a callback for each of several consecutive parts of a task, by name; `shares` is their work."""
    total, start, parts = sum(shares.values()), 0.0, {}
    for name, share in shares.items():
        parts[name] = subtask_progress(progress, start / total, share / total)
        start += share
    return parts


def parallel_progress(progress: ProgressCallback, names: Sequence[str]) -> dict[str, ProgressCallback]:
    """Return a thread-safe callback for each of several parallel tasks; no task's fraction ever falls."""
    fractions, lock = dict.fromkeys(names, 0.0), Lock()

    def reporter(name: str) -> ProgressCallback:
        def report(step: ProgressUpdate) -> None:
            with lock:
                fractions[name] = max(fractions[name], step.fraction)
                fraction = sum(fractions.values()) / len(fractions)
                progress(step._replace(stage=f"{name}: {step.stage}", fraction=fraction, task=name))

        return report

    return {name: reporter(name) for name in names}


def iteration_progress(progress: ProgressCallback, stage: str, name: str) -> IterationCallback:
    """Return a callback that reports the iterations of a search.

    The number of iterations until convergence is unknown, so the fraction approaches 1 asymptotically.
    """

    def report(number: int, error: float) -> None:
        fraction = number / (number + TYPICAL_ITERATIONS)
        progress(ProgressUpdate(stage, fraction, f"iteration {number}", {name: error}))

    return report
