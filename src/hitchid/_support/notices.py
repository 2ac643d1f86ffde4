"""Notices on data and results, as records."""

from dataclasses import dataclass, replace
from enum import Enum


class Severity(Enum):
    """Severity of a notice or finding, in descending order."""

    FAULT = "fault"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Notice:
    """A fact about data or results that is reported to the user.

    `str(notice)` is the printed text, `place: sentence`.

    Attributes:
        code: identifier for programs, such as `clock-resampled`.
        sentence: printed text, without capital letter and full stop.
        place: record, file, signal or direction concerned; may be empty.
        severity: fault, warning or note.
    """

    code: str
    sentence: str
    place: str = ""
    severity: Severity = Severity.NOTE

    def __str__(self) -> str:
        """Return the printed text."""
        return f"{self.place}: {self.sentence}" if self.place else self.sentence

    def at(self, place: str) -> "Notice":
        """Return the notice with an outer place prefixed to its own."""
        return replace(self, place=f"{place}: {self.place}" if self.place else place)
