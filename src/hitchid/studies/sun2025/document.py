"""Report of the study: tables and figures of the paper with our values, and our uncertainty."""

from collections.abc import Mapping, Sequence

from hitchid.report import (
    ChannelTraceFile,
    Document,
    Pictures,
    ReportSection,
    Table,
    Text,
    all_tables,
    direction_sections,
    sections,
    sentence,
)
from hitchid.studies.sun2025.figures import PaperFigure
from hitchid.validation import Validation

PREFACE = (
    "Sun et al. 2025 (Processes 13, 3608) measured on their own test bench; these "
    "tests were simulated on the virtual bench. The tables show both values; a "
    "difference does not rank the methods."
)


def study_report(
    tables: Sequence[Table],
    figures: Sequence[PaperFigure],
    result: Validation,
    *,
    trace: Mapping[str, ChannelTraceFile],
    command: str,
) -> Document:
    """Return the report of the study.

    Args:
        tables: Tables 2 to 4 of the paper and the figures in its text.
        figures: Figures 5 to 12 of the paper.
        result: of the validation.
        trace, command: as for `validation_report`.
    """
    data = result.report_data()
    pictures = tuple(picture for figure in figures for picture in figure.pictures)
    section_builders = (sections.accuracy, sections.trust, sections.parameters)
    return Document(
        title="The study of Sun et al. 2025, redone",
        subtitle="Lifting and lowering of an electro-hydraulic hitch on the virtual bench",
        verdict=sections.verdict(result, None),
        notices=tuple(map(sentence, result.notices)),
        sections=(
            ReportSection("Tables of the paper", (Text(PREFACE), *tables)),
            ReportSection("Figures of the paper", (Pictures(pictures),)),
            *direction_sections(result, data, trace, section_builders),
            sections.logs(data.logs),
            sections.origin(data.origin, command),
        ),
        summary=tuple(tables),
        data=result.metrics,
    )


def study_tables_document(tables: Sequence[Table], result: Validation) -> Document:
    """Return the tables of the paper and of the validation, the content of `study.md`."""
    section = ReportSection("", (*tables, *all_tables(result)))
    return Document(title="Study", notices=result.notices, sections=(section,), data=result.metrics)
