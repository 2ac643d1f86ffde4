"""What came of one campaign or one measured set, as JSON can hold it."""

import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from hitchid.errors import HitchError

MODEL, REFUSED, TRACEBACK, HUNG = "model", "refused", "traceback", "no answer"
TRACEBACK_LINES = 12


@dataclass
class Outcome:
    """What came of a run.

    Attributes:
        name, description: which run, and what it is.
        result: `model`, `refused` (a `HitchError`), `traceback`, or `no answer` in the time it had.
        stage: the stage that was the last to begin.
        message: of the error.
        seconds: stage to how long it took.
        figures: name to number.
        verdicts: sentences for the page.
        failures: sentences that say what should not be; none where all is well.
        determined, covered: parameters that were called determined where the truth is known; how many hold
            it.
    """

    name: str
    description: str = ""
    result: str = MODEL
    stage: str = ""
    message: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)
    verdicts: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    determined: int = 0
    covered: int = 0

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Time a stage, whatever it ends in."""
        self.stage, started = stage, time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - started


def run_guarded(outcome: Outcome, work: Callable[[Outcome], Any]) -> Outcome:
    """Do a work that fills in an outcome; an error becomes part of it."""
    try:
        work(outcome)
    except HitchError as error:
        outcome.result, outcome.message = REFUSED, str(error)
    except Exception as error:  # a traceback is what the gauntlet looks for
        outcome.result, outcome.message = (
            TRACEBACK,
            "".join(traceback.format_exception(error)[-TRACEBACK_LINES:]),
        )
        outcome.failures.append(f"{outcome.stage}: {type(error).__name__}: {error}")
    return outcome
