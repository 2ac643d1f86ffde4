"""The report of a validation: verdict first, then each direction, mixed cycles, logs, origin."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hitchid.data.campaign import Campaign
from hitchid.data.record import DISPLACEMENT
from hitchid.model import Hitch
from hitchid.report import sections
from hitchid.report.document import Document, ReportSection, sentence
from hitchid.report.sections import DirectionContext
from hitchid.validation import CYCLES, Acceptance, Validation

DIRECTION_SECTIONS = (
    sections.accuracy,
    sections.errors,
    sections.trust,
    sections.parameters,
    sections.search,
)


def validation_report(
    result: Validation,
    model: Hitch,
    campaign: Campaign,
    *,
    trace: Mapping[str, Any] | None = None,
    acceptance: Acceptance | None = None,
    command: str = "",
) -> Document:
    """Compose what a validation found for people to read.

    Args:
        result: of the validation.
        model: that was validated.
        campaign: the logs it was validated on.
        trace: how it was identified, as `load_trace` gives it.
        acceptance: which limits hold; None where none were set.
        command: that wrote the report.
    """
    counts = [_count(subset, len(tests.names)) for subset, tests in result.predictions.items()]
    return Document(
        title="Validation of a hitch model",
        subtitle=f"{', '.join(counts)}; {DISPLACEMENT} in {result.metrics['unit']}",
        verdict=sections.verdict(result, acceptance),
        notices=tuple(map(sentence, result.notices)),
        sections=(
            *([] if acceptance is None else [sections.limits(acceptance)]),
            *direction_sections(result, model, campaign, trace or {}, DIRECTION_SECTIONS),
            sections.logs(campaign, model),
            sections.origin(model, command),
        ),
    )


def direction_sections(
    result: Validation,
    model: Hitch,
    campaign: Campaign,
    trace: Mapping[str, Any],
    section_builders: Sequence[Callable[[DirectionContext], ReportSection]],
) -> list[ReportSection]:
    """Return a section for each direction that was validated, and one for mixed cycles.

    Args:
        result, model, campaign, trace: as for `validation_report`.
        section_builders: of the section of a direction.
    """
    unit = result.metrics["unit"]
    segmented = (
        campaign if campaign.directions else campaign.segmented(model.segmentation_dead_zones(campaign.units))
    )
    result_sections = []
    for direction, metrics in result.metrics["channels"].items():
        context = DirectionContext(
            direction=direction,
            metrics=metrics,
            predictions=result.predictions[direction],
            trace=trace.get(direction, {}),
            model=model,
            tests=segmented.of_kind(direction),
            ramps=segmented.ramps(direction),
            unit=unit,
        )
        subsections = [build_section(context) for build_section in section_builders]
        result_sections.append(
            ReportSection(
                direction.capitalize(),
                sections=tuple(subsection for subsection in subsections if subsection.blocks),
            )
        )
    if CYCLES in result.predictions:
        tests = result.predictions[CYCLES]
        result_sections.append(sections.cycles(result.metrics[CYCLES], tests, model.step_s, unit))
    return result_sections


def _count(subset: str, count: int) -> str:
    noun = "cycle" if subset == CYCLES else f"{subset} test"
    return f"{count} unseen {noun}{'s' if count != 1 else ''}"
