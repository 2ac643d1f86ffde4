"""Notices: facts about data and results that the user must see, as records."""

from dataclasses import dataclass, replace
from enum import Enum


class Severity(Enum):
    """Weight of a notice or finding, the gravest first."""

    FAULT = "fault"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Notice:
    """A fact about data or results that the user must see.

    `str(notice)` is the printed text, `place: sentence`.

    Attributes:
        code: fixed name of the fact, such as `clock-resampled`; for programs.
        sentence: for people; without capital letter and full stop.
        place: record, file, signal or direction concerned; empty where none is.
        severity: weight.
    """

    code: str
    sentence: str
    place: str = ""
    severity: Severity = Severity.NOTE

    def __str__(self) -> str:
        """Return the text that is printed."""
        return f"{self.place}: {self.sentence}" if self.place else self.sentence

    def at(self, place: str) -> "Notice":
        """Return the notice with an outer place put before its own."""
        return replace(self, place=f"{place}: {self.place}" if self.place else place)
