"""The study as a report: the paper's tables and figures with ours beside them, then how far to trust ours."""

from collections.abc import Mapping, Sequence
from typing import Any

from hitchid.data.campaign import Campaign
from hitchid.model import Hitch
from hitchid.report import Document, Pictures, ReportSection, Text, direction_sections, sections, sentence
from hitchid.studies.sun2025.figures import PaperFigure
from hitchid.validation import Table, Validation

PREFACE = (
    "Sun et al. 2025 (Processes 13, 3608) measured on a bench of their own; these tests ran on the virtual "
    "bench. The figures stand beside each other, not against each other."
)


def study_report(
    tables: Sequence[Table],
    figures: Sequence[PaperFigure],
    result: Validation,
    model: Hitch,
    campaign: Campaign,
    *,
    trace: Mapping[str, Any],
    command: str,
) -> Document:
    """Compose what the study found for people to read.

    Args:
        tables: Tables 2 to 4 of the paper and what its text names.
        figures: Figures 5 to 12 of the paper.
        result, model, campaign, trace, command: as for `validation_report`.
    """
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
            *direction_sections(result, model, campaign, trace, section_builders),
            sections.logs(campaign, model),
            sections.origin(model, command),
        ),
    )
