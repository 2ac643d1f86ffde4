"""The report of a validation: verdict first, then each direction, mixed cycles, logs, origin."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from hitchid.data.campaign import Campaign
from hitchid.data.record import DISPLACEMENT
from hitchid.model import Hitch
from hitchid.report import sections
from hitchid.report.document import Document, Section, sentence
from hitchid.report.sections import Direction
from hitchid.validation import CYCLES, Acceptance, Validation

PARTS = (
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
    counts = [_count(part, len(tests.names)) for part, tests in result.predictions.items()]
    return Document(
        title="Validation of a hitch model",
        subtitle=f"{', '.join(counts)}; {DISPLACEMENT} in {result.metrics['unit']}",
        verdict=sections.verdict(result, acceptance),
        notices=tuple(map(sentence, result.notices)),
        sections=(
            *([] if acceptance is None else [sections.limits(acceptance)]),
            *direction_sections(result, model, campaign, trace or {}, PARTS),
            sections.logs(campaign, model),
            sections.origin(model, command),
        ),
    )


def direction_sections(
    result: Validation,
    model: Hitch,
    campaign: Campaign,
    trace: Mapping[str, Any],
    parts: Sequence[Callable[[Direction], Section]],
) -> list[Section]:
    """Return a section for each direction that was validated, and one for mixed cycles.

    Args:
        result, model, campaign, trace: as for `validation_report`.
        parts: of the section of a direction.
    """
    unit = result.metrics["unit"]
    cut = campaign if campaign.modes else campaign.segmented(model.cut_at(campaign.units))
    found = []
    for mode, metrics in result.metrics["channels"].items():
        known = Direction(
            mode=mode,
            metrics=metrics,
            predictions=result.predictions[mode],
            trace=trace.get(mode, {}),
            model=model,
            tests=cut.of_kind(mode),
            ramps=cut.ramps(mode),
            unit=unit,
        )
        below = [part(known) for part in parts]
        found.append(Section(mode.capitalize(), sections=tuple(each for each in below if each.blocks)))
    if CYCLES in result.predictions:
        tests = result.predictions[CYCLES]
        found.append(sections.cycles(result.metrics[CYCLES], tests, model.step_s, unit))
    return found


def _count(part: str, count: int) -> str:
    what = "cycle" if part == CYCLES else f"{part} test"
    return f"{count} unseen {what}{'s' if count != 1 else ''}"
