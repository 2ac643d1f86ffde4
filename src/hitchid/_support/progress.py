"""How long work tells where it stands."""

from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from types import MappingProxyType
from typing import NamedTuple


class Step(NamedTuple):
    """Where long work stands.

    Attributes:
        stage: what is being done.
        fraction: of all work that is done.
        round: how far the stage is, as `iteration 40`; empty where it has no rounds.
        figures: what the stage makes smaller, name to its value now.
        strand: which of several works done at the same time tells; empty where there is one.
    """

    stage: str
    fraction: float
    round: str = ""
    figures: Mapping[str, float] = MappingProxyType({})
    strand: str = ""


Progress = Callable[[Step], None]
Heard = Callable[[int, float], None]
"""Called after a round of a search with its number and the best error so far."""


ROUNDS = 100


def silent(_: Step) -> None:
    """Tell nobody."""


def part(progress: Progress, start: float, width: float, name: str = "") -> Progress:
    """Return what tells of a part of the work as of the whole.

    Args:
        progress: of the whole.
        start, width: where the part begins and how much of the whole it is, fractions.
        name: put before each stage.
    """

    def tell(step: Step) -> None:
        stage = f"{name}: {step.stage}" if name else step.stage
        progress(step._replace(stage=stage, fraction=start + width * step.fraction))

    return tell


def strands(progress: Progress, start: float, width: float, names: Sequence[str]) -> dict[str, Progress]:
    """Return what tells of works done at the same time, by name; they tell one after the other.

    Args:
        progress: of the whole.
        start, width: where they begin and how much of the whole they are together, fractions.
        names: put before each stage.
    """
    done, one_at_a_time = dict.fromkeys(names, 0.0), Lock()

    def teller(name: str) -> Progress:
        def tell(step: Step) -> None:
            with one_at_a_time:
                done[name] = step.fraction
                fraction = start + width * sum(done.values()) / len(done)
                progress(step._replace(stage=f"{name}: {step.stage}", fraction=fraction, strand=name))

        return tell

    return {name: teller(name) for name in names}


def rounds(progress: Progress, stage: str, start: float, width: float, name: str) -> Heard:
    """Return what tells of a search round by round.

    A search stops when it has converged, so its length is not known before: the fraction nears its end.

    Args:
        progress: of the whole.
        stage: what is searched.
        start, width: where the search begins and how much of the whole it is, fractions.
        name: of the error that is made smaller.
    """

    def tell(number: int, error: float) -> None:
        done = start + width * number / (number + ROUNDS)
        progress(Step(stage, done, f"iteration {number}", {name: error}))

    return tell
