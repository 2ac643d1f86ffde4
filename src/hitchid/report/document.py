"""Document model of a report: findings, text, tables and figures in sections; the protocol of a renderer."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from hitchid._support.records import short_repr
from hitchid._support.tables import DataTable
from hitchid._support.tables import Faint as Faint
from hitchid._support.tables import Table as Table
from hitchid.report.svg import svg
from hitchid.validation import Check, Predictions


class Rating(Enum):
    """Rating of a finding; the value is the text of its symbol."""

    GOOD = "good"
    CAUTION = "caution"
    BAD = "bad"


@short_repr
class Finding(NamedTuple):
    """One finding and its rating."""

    level: Rating
    sentence: str


WORST_FIRST = (Rating.BAD, Rating.CAUTION, Rating.GOOD)


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings, the bad ones first; those of one rating stay in their order."""
    return tuple(sorted(findings, key=lambda finding: WORST_FIRST.index(finding.level)))


@short_repr
@dataclass(frozen=True)
class Picture:
    """A figure.

    Attributes:
        name: of its file, without suffix.
        figure: the matplotlib figure.
        caption: content of the figure and how to read it.
        alt: text for screen readers.
        wide: whether it takes the width of a page.
        data: the data behind it, column name with unit to values; empty for none.
    """

    name: str
    figure: Figure
    caption: str
    alt: str
    wide: bool = False
    data: Mapping[str, Sequence | np.ndarray] = field(default_factory=dict)

    @property
    def table(self) -> DataTable:
        """The data behind it as a table."""
        return DataTable.of_columns(self.name, self.data)

    @cached_property
    def svg(self) -> str:
        """The figure as an SVG file."""
        return svg(self.figure)


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Equation:
    """An equation as text and as MathML."""

    text: str
    mathml: str


@dataclass(frozen=True)
class Findings:
    """A list of findings."""

    items: tuple[Finding, ...]


@short_repr
@dataclass(frozen=True)
class Pictures:
    """A group of figures."""

    items: tuple[Picture, ...]


Block = Text | Equation | Findings | Pictures | Table


@short_repr
@dataclass(frozen=True)
class ReportSection:
    """A section: heading, blocks and subsections."""

    title: str
    blocks: tuple[Block, ...] = ()
    sections: tuple["ReportSection", ...] = ()

    def walk(self) -> Iterator[Block]:
        """Yield every block of this section and its subsections, in the order of the page."""
        yield from self.blocks
        for section in self.sections:
            yield from section.walk()


@short_repr
@dataclass(frozen=True)
class Signals:
    """Unseen tests with commands and predictions, sample by sample.

    Attributes:
        tests: direction, or `cycles`, to its tests.
        unit: of the displacement.
        command_unit: name of a command to its unit.
    """

    tests: Mapping[str, Predictions]
    unit: str
    command_unit: Mapping[str, str]


@short_repr
@dataclass(frozen=True)
class Document:
    """A report.

    Attributes:
        title: of the report.
        subtitle: its subject, one line.
        verdict: summary findings.
        notices: warnings on the figures.
        sections: the main part.
        summary: short tables for a terminal.
        checks: acceptance limits and their figures.
        data: all figures, the content of `metrics.json` or `comparison.json`.
        data_tables: every table as data, by name.
        signals: what the interactive page shows.
        uses: sentences on the use of each model, shown before everything else.
    """

    title: str
    subtitle: str = ""
    verdict: tuple[Finding, ...] = ()
    notices: tuple[str, ...] = ()
    sections: tuple[ReportSection, ...] = ()
    summary: tuple[Table, ...] = ()
    checks: tuple[Check, ...] = ()
    data: Mapping[str, object] = field(default_factory=dict)
    data_tables: Mapping[str, DataTable] = field(default_factory=dict)
    signals: Signals | None = None
    uses: tuple[str, ...] = ()

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


class Renderer(ABC):
    """An output format of a document.

    Other packages register an instance as an entry point in the group `hitchid.renderers`.

    Attributes:
        name: of the renderer, unique among all.
        suffix: file suffix, with the dot.
        package: package that it requires and hitchid does not; empty for none.
        extra: the optional dependency of hitchid that installs it.
    """

    name: ClassVar[str]
    suffix: ClassVar[str]
    package: ClassVar[str] = ""
    extra: ClassVar[str] = ""

    @abstractmethod
    def render(self, document: Document) -> bytes:
        """Return a document as the content of a file; equal documents give equal bytes.

        Raises:
            InputError: a package that the renderer requires is not installed.
        """


def sentence(notice: str) -> str:
    """Return a notice with an initial capital and a full stop."""
    return f"{notice[:1].upper()}{notice[1:]}."
