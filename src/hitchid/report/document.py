"""The document model of a report: findings, text, tables and figures in sections, for every renderer."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import NamedTuple

from matplotlib.figure import Figure

from hitchid.report.svg import svg
from hitchid.validation import Check


class Rating(Enum):
    """Rating of a finding; the value is the word beside its sign."""

    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"


class Finding(NamedTuple):
    """One finding and its rating."""

    level: Rating
    sentence: str


class Table(NamedTuple):
    """One table: a title, a header, and rows of text, the first column being names."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers rather than words."""
        columns = zip(*self.rows, strict=True) if self.rows else [()] * len(self.header)
        return [any(column) and all(map(_is_number, column)) for column in columns]


@dataclass(frozen=True)
class Picture:
    """A figure.

    Attributes:
        name: of its file, without suffix.
        figure: as drawn.
        caption: what it shows, and how to read it.
        alt: text for screen readers.
        wide: whether it needs the width of a page.
    """

    name: str
    figure: Figure
    caption: str
    alt: str
    wide: bool = False

    @cached_property
    def svg(self) -> str:
        """The figure as an SVG file."""
        return svg(self.figure)


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


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

    def walk(self) -> Iterator[Block]:
        """Yield every block of this section and of those below it, in the order of the page."""
        yield from self.blocks
        for section in self.sections:
            yield from section.walk()


@dataclass(frozen=True)
class Document:
    """A report.

    Attributes:
        title: of the report.
        subtitle: its subject, in a line.
        verdict: findings for a reader who reads no further.
        notices: findings that a reader must not miss.
        sections: the rest.
        summary: short tables for a terminal.
        checks: acceptance limits, each with its figure.
        data: all figures, in the form of `metrics.json` or `comparison.json`.
    """

    title: str
    subtitle: str = ""
    verdict: tuple[Finding, ...] = ()
    notices: tuple[str, ...] = ()
    sections: tuple[ReportSection, ...] = ()
    summary: tuple[Table, ...] = ()
    checks: tuple[Check, ...] = ()
    data: Mapping[str, object] = field(default_factory=dict)

    @property
    def blocks(self) -> Iterator[Block]:
        """Every block, in the order of the page."""
        for section in self.sections:
            yield from section.walk()

    @property
    def tables(self) -> list[Table]:
        """Every table, in the order of the page."""
        return [block for block in self.blocks if isinstance(block, Table)]

    @property
    def pictures(self) -> list[Picture]:
        """Every figure, in the order of the page."""
        return [picture for block in self.blocks if isinstance(block, Pictures) for picture in block.items]


def sentence(notice: str) -> str:
    """Return a notice with a capital and a full stop."""
    return f"{notice[:1].upper()}{notice[1:]}."


def _is_number(cell: str) -> bool:
    return cell in ("diverged", "any") or not any(letter.isalpha() for letter in cell.replace("e", ""))
