"""What adaptation did and why, as records and as lines of JSON."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter

from hitchid._support.records import short_repr
from hitchid.live.parameters import Changes

LEARNED, REFUSED, FAULT, CANDIDATE, DROPPED = "learned", "refused", "fault", "candidate", "dropped"
PROMOTED, MOVED, ROLLED_BACK = "promoted", "moved", "rolled back"
CHANGE_DETECTED, AT_LIMIT = "change detected", "at limit"
KINDS = (LEARNED, REFUSED, FAULT, CANDIDATE, DROPPED, PROMOTED, MOVED, ROLLED_BACK, CHANGE_DETECTED, AT_LIMIT)
LONGEST_S, MOST_STROKES = 1e10, 10**9  # of a change log: three hundred years, a stroke every ten seconds
# Kinds that are reported to the user at once.
REPORTED = (PROMOTED, ROLLED_BACK, CHANGE_DETECTED, AT_LIMIT, FAULT)


Stroke = Annotated[int, Field(ge=0, le=MOST_STROKES)]


def _whole(changes: object) -> object:
    """Return changes as they are read, after a check that none is missing: it would count as zero."""
    if isinstance(changes, Mapping) and set(changes) != set(Changes._fields):
        raise ValueError(f"expected {', '.join(Changes._fields)}")
    return changes


@short_repr
@dataclass(frozen=True)
class Event:
    """One entry of the change log.

    Attributes:
        kind: `learned` or `refused` of a stroke; `fault` of a sensor; `candidate`, `dropped`, `promoted` and
            `rolled back` of changes; `moved` of those in use; `change detected`; `at limit`.
        time_s: at the end of the stroke after which it happened, since the start of the change log, s; where
            that is gone on from, the time goes on, too.
        stroke: number of that stroke of the machine, from 1.
        direction: of the channel.
        reason: in words.
        changes: of the parameters in use after it; of a candidate its own.
        strokes: numbers of the strokes that a candidate was fitted to.
        figures: of a stroke that was learned from: errors, estimates, factor on the bands; of any stroke
            after a standstill: the leak.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", allow_inf_nan=False)

    kind: str
    time_s: Annotated[float, Field(ge=0, le=LONGEST_S)]
    stroke: Stroke
    direction: str
    reason: str
    changes: Annotated[Changes, BeforeValidator(_whole)]
    strokes: tuple[Stroke, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """The entry in words."""
        gain = 100 * math.expm1(self.changes.gain)
        changed = f"gain {gain:+.2g} %, dead zone {self.changes.dead_zone:+.3g}"
        shown = f" ({changed})" if self.kind in (PROMOTED, ROLLED_BACK, MOVED, AT_LIMIT) else ""
        reason = f": {self.reason}" if self.reason else ""
        return f"{self.direction} {self.kind}{shown}{reason}".lstrip()

    def to_json(self) -> str:
        """Return the entry as one line of JSON; its numbers are read back bit for bit."""
        content = {own.name: getattr(self, own.name) for own in fields(self)}
        content |= {"changes": self.changes._asdict(), "figures": dict(self.figures)}
        return json.dumps(content, allow_nan=False)

    @classmethod
    def from_json(cls, line: str | bytes) -> "Event":
        """Return the entry of a line.

        Raises:
            ValueError: the line is no entry.
        """
        event = _ENTRY.validate_json(line, strict=True)  # strict: "1" is no number in what was written here
        if event.kind not in KINDS:
            raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {event.kind!r}")
        return event


_ENTRY = TypeAdapter(Event)


def last_sample(events: Sequence[Event], step_s: float) -> int:
    """Return the number of the sample at which a change log ends; 0 of an empty one."""
    return round(max((event.time_s for event in events), default=0.0) / step_s)
