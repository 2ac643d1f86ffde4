"""Report of the study: tables and figures of the paper with our values, and our uncertainty."""

from collections.abc import Mapping, Sequence

from hitchid.report import (
    ChannelTraceFile,
    Document,
    Finding,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    all_tables,
    direction_sections,
    numbers,
    sections,
    sentence,
)
from hitchid.studies.sun2025.figures import PaperFigure
from hitchid.studies.sun2025.results import DirectionResult, summary
from hitchid.validation import Validation

PREFACE = (
    "Sun et al. 2025 (Processes 13, 3608) measured on their own test bench; these "
    "tests were simulated on the virtual bench. The tables show both values; a "
    "difference does not rank the methods. Both methods were identified from the same tests: the paper's as "
    "published, and hitchid's default, which chooses the form of the physics model."
)


def study_report(
    tables: Sequence[Table],
    figures: Sequence[PaperFigure],
    results: Mapping[str, DirectionResult],
    result: Validation,
    *,
    trace: Mapping[str, ChannelTraceFile],
    command: str,
) -> Document:
    """Return the report of the study.

    Args:
        tables: Tables 2 to 4 of the paper and the figures in its text.
        figures: Figures 5 to 12 of the paper.
        results: direction to predictions of both methods.
        result: of the validation of hitchid's default model.
        trace, command: as for `validation_report`.
    """
    data = result.report_data()
    pictures = tuple(picture for figure in figures for picture in figure.pictures)
    section_builders = (sections.accuracy, sections.trust, sections.parameters)
    return Document(
        title="The study of Sun et al. 2025, redone",
        subtitle="Lifting and lowering of an electro-hydraulic hitch on the virtual bench",
        verdict=(
            *(_default_finding(direction, each, result.unit) for direction, each in results.items()),
            *sections.verdict(result, None),
        ),
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


def _default_finding(direction: str, result: DirectionResult, unit: str) -> Finding:
    """Return the free run of the default beside that of the paper's method; good if significantly better."""
    texts = {
        model: numbers.with_error(figures.rmse, figures.rmse_error)
        for model in ("free_run", "paper", "transfer_function")
        for figures in (summary(result.test, model),)
    }
    text = (
        f"{direction.capitalize()}, hitchid's default, free run: RMSE {texts['free_run']} {unit} on "
        f"{numbers.count(len(result.test.names), 'unseen test')}; the paper's method on its own predictions "
        f"{texts['paper']}, its transfer function {texts['transfer_function']}"
    )
    if all(
        result.test.is_significantly_better("free_run", model) for model in ("paper", "transfer_function")
    ):
        return Finding(Rating.GOOD, f"{text}: significantly better than both.")
    return Finding(Rating.CAUTION, f"{text}: not significantly better than both.")


def study_tables_document(tables: Sequence[Table], result: Validation) -> Document:
    """Return the tables of the paper and of the validation, the content of `study.md`."""
    section = ReportSection("", (*tables, *all_tables(result)))
    return Document(title="Study", notices=result.notices, sections=(section,), data=result.metrics)
