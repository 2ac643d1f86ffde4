"""Findings of an audit, and the time intervals they concern."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite

import numpy as np

from hitchid._support.notices import Severity
from hitchid._support.short_repr import short_repr
from hitchid.data.record import Record

MAX_SPANS = 50  # intervals listed in one finding (chosen)


@short_repr
@dataclass(frozen=True)
class AuditFinding:
    """One finding of an audit.

    Attributes:
        check: short name of the check.
        severity: `FAULT` (a model from this would be wrong), `WARNING` or `NOTE`.
        record: name of the record; empty for several or all.
        signal: role of the signal; empty for none or several.
        spans: intervals (start, stop) in s of the log's own time; empty for the whole log.
        what: the fault, with numbers and units.
        advice: the remedy, or what to measure again.
        merged: the findings on single records that were merged into this one.
    """

    check: str
    severity: Severity
    record: str
    signal: str
    spans: tuple[tuple[float, float], ...]
    what: str
    advice: str
    merged: tuple["AuditFinding", ...] = ()

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records concerned; empty for the whole campaign."""
        names = [self.record] if self.record else [finding.record for finding in self.merged]
        return tuple(dict.fromkeys(names))

    @property
    def locations(self) -> tuple[tuple[str, float, float], ...]:
        """Intervals as record, start and stop in s of its own time; empty for whole records."""
        return tuple((finding.record, *span) for finding in (self, *self.merged) for span in finding.spans)

    def describe(self) -> dict[str, object]:
        """Return the content of JSON output."""
        return {
            "check": self.check,
            "level": self.severity.value,
            "records": list(self.records),
            "signal": self.signal,
            "places": [
                {"record": record, "start_s": start, "stop_s": stop} for record, start, stop in self.locations
            ],
            "what": self.what,
            "advice": self.advice,
        }


def true_intervals(condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return start and stop of every interval where a condition is true.

    Args:
        condition: booleans, shape [N].

    Returns:
        First samples and one past the last, each of shape [M].
    """
    edges = np.flatnonzero(np.diff(condition.astype(np.int8), prepend=0, append=0))
    return edges[::2], edges[1::2]


def spans_of(record: Record, stretches: Iterable[tuple[int, int]]) -> tuple[tuple[float, float], ...]:
    """Return times of first and last sample of `start:stop`, s; at most the 50 longest intervals."""
    selected = list(stretches)
    if len(selected) > MAX_SPANS:
        selected = sorted(sorted(selected, key=lambda interval: interval[0] - interval[1])[:MAX_SPANS])
    times = [
        (record.start_s + int(start) * record.step_s, record.start_s + (int(stop) - 1) * record.step_s)
        for start, stop in selected
    ]
    return tuple((round(a, 6), round(b, 6)) for a, b in times if isfinite(a) and isfinite(b))
