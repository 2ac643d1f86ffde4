"""Adaptation of the model beside the machine: its start, its change log, and what the page shows of it."""

import math
from collections import Counter, deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from hitchid.adaptation import Changes, Event
from hitchid.adaptation.events import (
    AT_LIMIT,
    CHANGE_DETECTED,
    FAULT,
    LEARNED,
    PROMOTED,
    REFUSED,
    ROLLED_BACK,
)
from hitchid.errors import InputError
from hitchid.model import Hitch, save
from hitchid.online import ChangeLog, OnlineAdaptation

STARTING, ON = "starting", "on"
# Kinds of events that are shown, and how many: refused strokes must not hide the others; chosen.
SHOWN = {(PROMOTED, ROLLED_BACK, CHANGE_DETECTED, AT_LIMIT, FAULT): 6, (REFUSED,): 2}


class ModelAdaptation:
    """Adaptation of one model, in the units of a source.

    It starts in a thread of its own, as that takes seconds: the predictions go on meanwhile.

    Args:
        model: identified hitch.
        path: of its change log; adaptation goes on from an existing one.
        command_factors: direction to what a command of the source is multiplied by to be in the model's unit.

    Raises:
        InputError, OutputError: the file is no change log, that of another model, or cannot be written.
    """

    def __init__(self, model: Hitch, path: Path, command_factors: Mapping[str, float]) -> None:
        self._factors, self._at_s = command_factors, 0.0
        self._log = ChangeLog(path, model)
        self._promoted: Counter[str] = Counter()
        self._strokes: Counter[str] = Counter()
        self._events = {kinds: deque[dict[str, Any]](maxlen=most) for kinds, most in SHOWN.items()}
        for event in self._log.earlier:
            self._count(event)
        self._directions = tuple(model.channels)
        executor = ThreadPoolExecutor(1)
        self._starting: Future[OnlineAdaptation] = executor.submit(
            OnlineAdaptation, model, log=self._take, earlier=self._log.earlier
        )
        executor.shutdown(wait=False)
        self._online: OnlineAdaptation | None = None

    @property
    def model(self) -> Hitch | None:
        """The model in use; None before the start."""
        return None if self._online is None else self._online.model

    def start(self) -> bool:
        """Return whether it has started since the last call.

        Raises:
            InputError: the model cannot be adapted.
        """
        if self._online is not None or not self._starting.done():
            return False
        self._online = self._starting.result()
        return True

    def feed(self, begin_s: float, commands: np.ndarray, displacement: np.ndarray) -> bool:
        """Take a block of samples in the model's units; return whether anything was learned.

        Args:
            begin_s: time of its first sample, s.
            commands: lifting and lowering, shape [B, 2].
            displacement: NaN where there is none, shape [B].

        Raises:
            OutputError: the change log cannot be written.
        """
        if self._online is None:
            return False
        self._at_s = begin_s
        return bool(self._online.feed(commands, displacement))

    def roll_back(self, direction: object) -> None:
        """Return to the parameters of one direction before its last promotion, as soon as nothing moves."""
        self._started.rollback(str(direction))

    def save(self, folder: Path) -> None:
        """Write the model in use.

        Raises:
            OutputError: the folder exists, or cannot be written.
        """
        save(self._started.model, folder)

    def end(self) -> None:
        """End learning; strokes that are being learned from go into the change log."""
        if self._online is None:
            self._starting.add_done_callback(_abandon)
        else:
            self._online.finish()
        self._log.close()

    def describe(self) -> dict[str, object]:
        """Return what the page shows: parameters in use in the units of the source, newest events first."""
        changes = {} if self._online is None else self._online.changes
        return {
            "state": STARTING if self._online is None else ON,
            "strokes": {"learned": self._strokes[LEARNED], "refused": self._strokes[REFUSED]},
            "directions": {
                direction: {
                    **self._shown(direction, changes.get(direction, Changes())),
                    "can_roll_back": self._online is not None and self._promoted[direction] > 0,
                }
                for direction in self._directions
            },
            "events": sorted(chain(*self._events.values()), key=itemgetter("at_s"), reverse=True),
        }

    @property
    def _started(self) -> OnlineAdaptation:
        if self._online is None:
            raise InputError("adaptation has not started yet; wait until it is on")
        return self._online

    def _take(self, event: Event) -> None:
        self._log.write(event)
        self._count(event)
        self._strokes[event.kind] += 1
        shown = {"kind": event.kind, "direction": event.direction, "reason": event.reason, "at_s": self._at_s}
        for kinds, latest in self._events.items():
            if event.kind in kinds:
                latest.append({**shown, **self._shown(event.direction, event.changes)})

    def _count(self, event: Event) -> None:
        """Count the promotions that can be taken back."""
        if event.kind == PROMOTED:
            self._promoted[event.direction] += 1
        elif event.kind == ROLLED_BACK:
            self._promoted[event.direction] = max(0, self._promoted[event.direction] - 1)

    def _shown(self, direction: str, changes: Changes) -> dict[str, float]:
        return {
            "gain_percent": 100 * math.expm1(changes.gain),
            "dead_zone": changes.dead_zone / self._factors.get(direction, 1.0),
        }


def _abandon(starting: Future[OnlineAdaptation]) -> None:
    """End an adaptation that has started after it was switched off."""
    if not starting.cancelled() and starting.exception() is None:
        starting.result().finish()
