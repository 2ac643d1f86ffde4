"""Report of a validation: verdict, each direction, mixed cycles, logs, origin."""

from collections.abc import Callable, Mapping, Sequence

from hitchid.data.record import DISPLACEMENT
from hitchid.model import Provenance
from hitchid.report import numbers, sections, tables
from hitchid.report.document import Document, ReportSection, Signals, Table, sentence
from hitchid.report.sections import DirectionContext
from hitchid.report.trace_file import ChannelTraceFile
from hitchid.validation import CYCLES, Acceptance, ReportData, Validation
from hitchid.validation.names import in_table_order, model_name

SectionBuilder = Callable[[DirectionContext], ReportSection]
DIRECTION_SECTIONS: tuple[SectionBuilder, ...] = (
    sections.overview,
    sections.parameters,
    sections.accuracy,
    sections.errors,
    sections.trust,
    sections.search,
)


def validation_report(
    result: Validation,
    data: ReportData,
    *,
    trace: Mapping[str, ChannelTraceFile] | None = None,
    acceptance: Acceptance | None = None,
    command: str = "",
) -> Document:
    """Return the report of a validation.

    Args:
        result: of the validation.
        data: its `report_data()`.
        trace: trace of the identification, as `read_trace` returns it.
        acceptance: result of the acceptance limits; None without limits.
        command: the command line that wrote the report.
    """
    counts = [_count(direction, len(accuracy.tests)) for direction, accuracy in result.accuracy.items()]
    return Document(
        title=_title(result.model.provenance),
        subtitle=f"{', '.join(counts)}; {DISPLACEMENT} in {result.unit}",
        uses=sections.uses(result),
        verdict=sections.verdict(result, acceptance),
        notices=tuple(map(sentence, result.notices)),
        sections=(
            *([] if acceptance is None else [sections.limits(acceptance)]),
            *direction_sections(result, data, trace or {}, DIRECTION_SECTIONS),
            sections.logs(data.logs),
            sections.origin(data.origin, command),
        ),
        summary=tuple(_summary(result)),
        checks=() if acceptance is None else acceptance.checks,
        data=result.metrics,
        data_tables=result.tables() | ({} if acceptance is None else {"limits": acceptance.table()}),
        signals=Signals(result.predictions, result.unit, result.model.units),
    )


def direction_sections(
    result: Validation,
    data: ReportData,
    trace: Mapping[str, ChannelTraceFile],
    builders: Sequence[SectionBuilder],
) -> list[ReportSection]:
    """Return one section per validated direction, and one for mixed cycles.

    Args:
        result, data, trace: as for `validation_report`.
        builders: functions that build the subsections of a direction.
    """
    step_s, unit = data.origin.step_s, result.unit
    result_sections = []
    for direction, channel in result.channels.items():
        context = DirectionContext(
            direction, channel, trace.get(direction), data.directions[direction], step_s, unit
        )
        below = tuple(section for section in (build(context) for build in builders) if section.blocks)
        result_sections.append(ReportSection(direction.capitalize(), sections=below))
    if result.cycles is not None:
        result_sections.append(sections.cycles(result.cycles.accuracy, step_s, unit))
    return result_sections


def validation_tables(result: Validation) -> Document:
    """Return every table of a validation, the content of `tables.md`."""
    return Document(
        title="Validation",
        notices=result.notices,
        sections=(ReportSection("", tuple(all_tables(result))),),
        data=result.metrics,
    )


def all_tables(result: Validation) -> list[Table]:
    """Return accuracy, horizons, single tests, parameters, bands, residuals and searches of each direction,
    and the tables of mixed cycles."""
    unit = result.unit
    table_list: list[Table] = []
    for direction, channel in result.channels.items():
        accuracy = channel.accuracy
        table_list += [
            tables.accuracy_table(direction, accuracy, unit),
            tables.horizon_table(direction, accuracy, unit),
            tables.single_test_table(direction, accuracy, unit),
        ]
        if channel.parameters is not None:
            title = f"{direction}: parameters of the physics model"
            table_list.append(tables.parameter_table(title, channel.parameters))
        if channel.characteristics is not None:
            table_list += tables.characteristic_tables(direction, channel.characteristics)
        if channel.load_scatter is not None:
            table_list.append(tables.load_table(direction, channel.load_scatter))
        if channel.paper_parameters is not None:
            title = f"{direction}: parameters of the paper's transfer function"
            table_list.append(tables.parameter_table(title, channel.paper_parameters))
        if accuracy.bands is not None:
            table_list.append(tables.band_table(direction, accuracy.bands, unit))
        table_list.append(tables.residual_table(direction, channel.residuals, unit))
        if channel.searches:
            table_list.append(tables.search_table(direction, channel.searches, unit))
    return (
        table_list
        if result.cycles is None
        else table_list + tables.cycle_tables(result.cycles.accuracy, unit)
    )


def _summary(result: Validation) -> list[Table]:
    return [
        tables.summary_table(
            direction,
            [(model_name(name), accuracy.models[name]) for name in in_table_order(accuracy.models)],
            result.unit,
        )
        for direction, accuracy in result.accuracy.items()
    ]


def _title(provenance: Provenance) -> str:
    if not provenance.name:
        return "Validation of a model"
    return f"Validation of {provenance.name} ({provenance.date})"


def _count(direction: str, count: int) -> str:
    return numbers.count(count, "unseen cycle" if direction == CYCLES else f"unseen {direction} test")
