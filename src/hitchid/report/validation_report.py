"""Report of a validation: verdict, each direction, mixed cycles, logs, origin."""

from collections.abc import Callable, Mapping, Sequence

from hitchid.logs.record import DISPLACEMENT
from hitchid.model import Provenance
from hitchid.model.trace import ChannelTraceFile
from hitchid.report import figure_data, figures, numbers
from hitchid.report.context import DirectionContext
from hitchid.report.document import (
    Block,
    Document,
    Picture,
    Pictures,
    ReportSection,
    Signals,
    Table,
    sentence,
)
from hitchid.report.figures.errors import MAX_SAMPLES
from hitchid.report.origin import logs_section, origin_section, search_section
from hitchid.report.overview import overview_section, simulated_models
from hitchid.report.parameters_section import parameters_section
from hitchid.report.tables import (
    accuracy_table,
    band_table,
    characteristic_tables,
    cycle_tables,
    horizon_table,
    load_table,
    parameter_table,
    residual_table,
    search_table,
    single_test_table,
    summary_table,
)
from hitchid.report.verdict import limits_section, uses_section, verdict_section
from hitchid.validation import CYCLES, Acceptance, Accuracy, ReportData, Validation
from hitchid.validation.results import BENCHMARK, FREE_RUN, LABELS, in_table_order, model_name, shown_tests

# Errors of one direction: every model, over horizons, by test, distribution.

COMPARED_MODELS = ("lstm", "narx", "oe", "arx", "transfer_function", BENCHMARK, FREE_RUN)


def accuracy_section(context: DirectionContext) -> ReportSection:
    """Return the section on the errors of the model and of every baseline."""
    result, unit, tests = context.accuracy, context.unit, context.accuracy.predictions
    unlabelled = [name for name in tests.models if name not in LABELS]
    models = [*unlabelled, *(name for name in COMPARED_MODELS if name in tests.models)]
    pictures = (
        Picture(
            context.figure_name("horizons"),
            figures.horizons(result.horizons, context.step_s, unit),
            "Error over the prediction horizon. A useful model is below persistence.",
            f"RMSE in {unit} over the horizon for each model, from one sample on.",
            data=figure_data.horizons(result.horizons, context.step_s, unit),
        ),
        Picture(
            context.figure_name("tests"),
            figures.errors_by_test(tests, unit, models),
            "RMSE of each unseen test in free run; the bar is the RMSE over all tests.",
            f"RMSE of each of {len(tests.names)} tests in free run, for {len(models)} models.",
            data=figure_data.errors_by_test(tests, unit, models),
        ),
    )
    tables = (accuracy_table(context.direction, result, unit), horizon_table(context.direction, result, unit))
    return ReportSection("Accuracy", (*tables, Pictures(pictures)))


def errors_section(context: DirectionContext) -> ReportSection:
    """Return the section on the distribution of the errors, and on single tests."""
    tests, unit = context.accuracy.predictions, context.unit
    models = simulated_models(tests)
    model_errors = {name: tests.errors(name) for name in reversed(models)}
    pictures = [
        Picture(
            context.figure_name("distribution"),
            figures.error_distribution(model_errors, unit),
            "Errors on all unseen tests: histogram with fitted normal, and the share of samples below a "
            "limit. The axes end where 99.5 % of the samples lie.",
            f"Histogram and cumulative distribution of errors in {unit}.",
            data=figure_data.errors(model_errors, unit),
        ),
    ]
    if context.data.channel.compensator is not None:
        pictures.append(
            Picture(
                context.figure_name("predicted-errors"),
                figures.predicted_errors({"test": tests}, unit),
                "Error of the physics model, and the LSTM correction's prediction of it one step ahead.",
                f"Error of the physics model in {unit} over the samples, actual and predicted.",
                data=figure_data.predicted_errors({"test": tests}, unit, MAX_SAMPLES),
            )
        )
    table = single_test_table(context.direction, context.accuracy, unit)
    return ReportSection("Errors", (Pictures(tuple(pictures)), table))


# Section on mixed cycles of lifting, holding and lowering.

MODELS = ("benchmark", "free_run")


def cycles_section(accuracy: Accuracy, step_s: float, unit: str) -> ReportSection:
    """Return the section on mixed cycles.

    Args:
        accuracy: on the unseen cycles.
        step_s: sampling time, s.
        unit: of the displacement.
    """
    tests = accuracy.predictions
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    model_errors = {name: tests.errors(name) for name in reversed(MODELS)}
    first_table, *others = cycle_tables(accuracy, unit)
    pictures = (
        Picture(
            "cycles-outputs",
            figures.outputs(selected_tests, unit, MODELS),
            f"Measured and predicted displacement, and errors: {selection_text.replace('test', 'cycle')} "
            f"({names}).",
            f"Displacement and error over time of {names}, free run.",
            data=figure_data.outputs(selected_tests, unit, MODELS),
        ),
        Picture(
            "cycles-distribution",
            figures.error_distribution(model_errors, unit),
            "Errors on all unseen cycles in free run.",
            f"Histogram and cumulative distribution of errors in {unit}.",
            data=figure_data.errors(model_errors, unit),
        ),
        Picture(
            "cycles-horizons",
            figures.horizons(accuracy.horizons, step_s, unit),
            "Error over the prediction horizon, including changes of direction.",
            f"RMSE in {unit} over the horizon.",
            data=figure_data.horizons(accuracy.horizons, step_s, unit),
        ),
    )
    return ReportSection("Mixed cycles", (first_table, Pictures(pictures), *others))


# Section on prediction bands and residual tests of one direction.


def trust_section(context: DirectionContext) -> ReportSection:
    """Return the section on bands and on tests of the errors."""
    result, unit = context.result, context.unit
    blocks: list[Block] = []
    pictures = []
    bands = context.accuracy.bands
    if bands is not None:
        blocks.append(band_table(context.direction, bands, unit))
        pictures.append(
            Picture(
                context.figure_name("coverage"),
                figures.coverage(bands, context.step_s),
                "Share of unseen samples inside the bands, and their nominal coverage.",
                "Coverage of the bands in percent over the horizon.",
                data=figure_data.coverage(bands, context.step_s),
            )
        )
    free_run = result.residuals[FREE_RUN]
    if free_run is not None:
        blocks.append(residual_table(context.direction, result.residuals, unit))
        pictures += [
            Picture(
                context.figure_name("correlations"),
                figures.residual_correlations(free_run),
                "Free run: autocorrelation of the errors and correlation with the command. Values outside "
                "the bounds are errors that a better model could explain.",
                "Autocorrelation of the errors and their correlation with the command, with 99 % bounds.",
                data=figure_data.residual_correlations(free_run),
            ),
            Picture(
                context.figure_name("places"),
                figures.residuals_by_variable(free_run, unit, context.data.command_unit),
                "Free run: mean error (bar) and its spread (line) by displacement, speed and command beyond "
                "the dead zone. A bar away from zero is a systematic error.",
                f"Mean and spread of the errors in {unit} by displacement, speed and command.",
                data=figure_data.residuals_by_variable(free_run, unit, context.data.command_unit),
            ),
        ]
    return ReportSection("Trust", (*blocks, *([Pictures(tuple(pictures))] if pictures else [])))


SectionBuilder = Callable[[DirectionContext], ReportSection]
DIRECTION_SECTIONS: tuple[SectionBuilder, ...] = (
    overview_section,
    parameters_section,
    accuracy_section,
    errors_section,
    trust_section,
    search_section,
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
        uses=uses_section(result),
        verdict=verdict_section(result, acceptance),
        notices=tuple(map(sentence, result.notices)),
        sections=(
            *([] if acceptance is None else [limits_section(acceptance)]),
            *direction_sections(result, data, trace or {}, DIRECTION_SECTIONS),
            logs_section(data.logs),
            origin_section(data.origin, command),
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
        result_sections.append(cycles_section(result.cycles.accuracy, step_s, unit))
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
            accuracy_table(direction, accuracy, unit),
            horizon_table(direction, accuracy, unit),
            single_test_table(direction, accuracy, unit),
        ]
        if channel.parameters is not None:
            title = f"{direction}: parameters of the physics model"
            table_list.append(parameter_table(title, channel.parameters))
        if channel.characteristics is not None:
            table_list += characteristic_tables(direction, channel.characteristics)
        if channel.load_scatter is not None:
            table_list.append(load_table(direction, channel.load_scatter))
        if channel.paper_parameters is not None:
            title = f"{direction}: parameters of the paper's transfer function"
            table_list.append(parameter_table(title, channel.paper_parameters))
        if accuracy.bands is not None:
            table_list.append(band_table(direction, accuracy.bands, unit))
        table_list.append(residual_table(direction, channel.residuals, unit))
        if channel.searches:
            table_list.append(search_table(direction, channel.searches, unit))
    return table_list if result.cycles is None else table_list + cycle_tables(result.cycles.accuracy, unit)


def _summary(result: Validation) -> list[Table]:
    return [
        summary_table(
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
