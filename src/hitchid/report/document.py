"""What a report is made of, whatever it is written as: findings, text, tables, figures, in sections."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from matplotlib.figure import Figure

from hitchid.validation import Table


class Rating(Enum):
    """How a finding is meant; the value is the word that goes with its sign."""

    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"


class Finding(NamedTuple):
    """One thing a reader should know."""

    level: Rating
    sentence: str


class Picture(NamedTuple):
    """A figure.

    Attributes:
        name: of its file, without ending.
        figure: as drawn.
        caption: what is seen, and how to read it.
        alt: what it shows, for who cannot see it.
        wide: whether it needs the width of a page.
    """

    name: str
    figure: Figure
    caption: str
    alt: str
    wide: bool = False


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    said: str


@dataclass(frozen=True)
class Findings:
    """Findings, one below the other."""

    items: tuple[Finding, ...]


@dataclass(frozen=True)
class Pictures:
    """Figures that belong together."""

    items: tuple[Picture, ...]


Block = Text | Findings | Pictures | Table


@dataclass(frozen=True)
class ReportSection:
    """Blocks under a heading, and sections below it."""

    title: str
    blocks: tuple[Block, ...] = ()
    sections: tuple["ReportSection", ...] = ()


@dataclass(frozen=True)
class Document:
    """A report.

    Attributes:
        title: what it is of.
        subtitle: what it is from, in a line.
        verdict: what a reader should know who reads no further.
        notices: what to keep in mind beside it.
        sections: the rest.
    """

    title: str
    subtitle: str
    verdict: tuple[Finding, ...]
    notices: tuple[str, ...]
    sections: tuple[ReportSection, ...]

    @property
    def pictures(self) -> Iterator[Picture]:
        """Every figure, in the order of the page."""
        for section in self.sections:
            yield from _pictures(section)


def sentence(notice: str) -> str:
    """Return a notice with a capital and a full stop."""
    return f"{notice[:1].upper()}{notice[1:]}."


def _pictures(section: ReportSection) -> Iterator[Picture]:
    for block in section.blocks:
        if isinstance(block, Pictures):
            yield from block.items
    for subsection in section.sections:
        yield from _pictures(subsection)
