"""Report of a validation: verdict, each direction, mixed cycles, logs, origin."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from hitchid._support import numbers
from hitchid.logs.record import DISPLACEMENT
from hitchid.model.trace import ChannelTraceFile
from hitchid.report import figures
from hitchid.report.context import DirectionContext
from hitchid.report.document import (
    Block,
    Document,
    Pictures,
    ReportSection,
    Signals,
    Table,
    sentence,
)
from hitchid.report.origin import logs_section, origin_section, search_section
from hitchid.report.parameters_section import characteristic_sentences, parameters_section
from hitchid.report.verdict import limits_section, uses_section, verdict_section
from hitchid.validation import CYCLES, Acceptance, Accuracy, Predictions, ReportData, Validation
from hitchid.validation.estimate_tables import (
    characteristic_table,
    load_table,
    parameter_table,
    speed_map_table,
)
from hitchid.validation.results import (
    BENCHMARK,
    FREE_RUN,
    LABELS,
    ONE_STEP,
    ChannelResult,
    in_table_order,
    model_name,
    shown_tests,
)
from hitchid.validation.tables import (
    accuracy_table,
    band_table,
    horizon_table,
    residual_table,
    search_table,
    single_test_table,
    summary_table,
)

# Sections of one direction: outputs and speed map, errors, trust.

COMPARED_MODELS = ("lstm", "narx", "oe", "arx", "transfer_function", BENCHMARK, FREE_RUN)


def overview_section(context: DirectionContext) -> ReportSection:
    """Return the section with measured and simulated displacement, and the speed over the command."""
    tests, unit, characteristics = context.accuracy.predictions, context.unit, context.result.characteristics
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    equal_note = " The network correction is not used in simulation." if tests.uncompensated else ""
    rmse = context.accuracy.free_run().rmse
    error_text = "the free run diverged" if rmse is None else f"free-run RMSE {rmse:.3g} {unit}"
    pictures = [
        figures.outputs(
            context.figure_name("outputs"),
            selected_tests,
            unit,
            _simulated_models(tests),
            f"Measured and predicted displacement, and the errors: {selection_text} ({names}).{equal_note}",
            f"Displacement and error over time of {names}; {error_text}.",
        )
    ]
    if characteristics is not None:
        words = " ".join(map(sentence, characteristic_sentences(characteristics, context.direction)))
        pictures.append(figures.speed_map(context.figure_name("speed-map"), characteristics, words))
    return ReportSection("Measured and simulated", (Pictures(tuple(pictures)),))


def _simulated_models(tests: Predictions) -> tuple[str, ...]:
    """Return the runs that are drawn; the physics model only where the grey box differs from it."""
    return (FREE_RUN, ONE_STEP) if tests.uncompensated else (BENCHMARK, FREE_RUN, ONE_STEP)


def accuracy_section(context: DirectionContext) -> ReportSection:
    """Return the section on the errors of the model and of every baseline."""
    result, unit, tests = context.accuracy, context.unit, context.accuracy.predictions
    unlabelled = [name for name in tests.models if name not in LABELS]
    models = [*unlabelled, *(name for name in COMPARED_MODELS if name in tests.models)]
    pictures = (
        figures.horizons(
            context.figure_name("horizons"),
            result.horizons,
            context.step_s,
            unit,
            "Error over the prediction horizon. A useful model is below persistence.",
            f"RMSE in {unit} over the horizon for each model, from one sample on.",
        ),
        figures.errors_by_test(
            context.figure_name("tests"),
            tests,
            unit,
            models,
            "RMSE of each unseen test in free run; the bar is the RMSE over all tests.",
            f"RMSE of each of {len(tests.names)} tests in free run, for {len(models)} models.",
        ),
    )
    table = accuracy_table(context.direction, result, unit).shown()
    horizons = horizon_table(context.direction, result, unit)
    return ReportSection("Accuracy", (table, horizons, Pictures(pictures)))


def errors_section(context: DirectionContext) -> ReportSection:
    """Return the section on the distribution of the errors, and on single tests."""
    tests, unit = context.accuracy.predictions, context.unit
    pictures = [
        figures.error_distribution(
            context.figure_name("distribution"),
            {name: tests.errors(name) for name in reversed(_simulated_models(tests))},
            unit,
            "Errors on all unseen tests: histogram with fitted normal, and the share of samples below a "
            "limit. The axes end where 99.5 % of the samples lie.",
            f"Histogram and cumulative distribution of errors in {unit}.",
        ),
    ]
    if context.data.channel.compensator is not None:
        pictures.append(
            figures.predicted_errors(
                context.figure_name("predicted-errors"),
                {"test": tests},
                unit,
                "Error of the physics model, and the LSTM correction's prediction of it one step ahead.",
                f"Error of the physics model in {unit} over the samples, actual and predicted.",
            )
        )
    table = single_test_table(context.direction, context.accuracy, unit).shown()
    return ReportSection("Errors", (Pictures(tuple(pictures)), table))


def trust_section(context: DirectionContext) -> ReportSection:
    """Return the section on bands and on tests of the errors."""
    result, unit, bands = context.result, context.unit, context.accuracy.bands
    blocks: list[Block] = []
    pictures = []
    if bands is not None:
        blocks.append(band_table(context.direction, bands, unit).shown())
        pictures.append(figures.coverage(context.figure_name("coverage"), bands, context.step_s))
    free_run = result.residuals[FREE_RUN]
    if free_run is not None:
        blocks.append(residual_table(context.direction, result.residuals, unit))
        pictures += [
            figures.residual_correlations(context.figure_name("correlations"), free_run),
            figures.residuals_by_variable(
                context.figure_name("places"), free_run, unit, context.data.command_unit
            ),
        ]
    return ReportSection("Trust", (*blocks, *([Pictures(tuple(pictures))] if pictures else [])))


# Section on mixed cycles of lifting, holding and lowering.

MODELS = ("benchmark", "free_run")


def cycles_section(accuracy: Accuracy, step_s: float, unit: str) -> ReportSection:
    """Return the section on mixed cycles; the sampling time in s, the unit that of the displacement."""
    tests = accuracy.predictions
    selected_tests, selection_text = shown_tests(tests)
    names = ", ".join(selected_tests.names)
    pictures = (
        figures.outputs(
            "cycles-outputs",
            selected_tests,
            unit,
            MODELS,
            f"Measured and predicted displacement, and errors: {selection_text.replace('test', 'cycle')} "
            f"({names}).",
            f"Displacement and error over time of {names}, free run.",
        ),
        figures.error_distribution(
            "cycles-distribution",
            {name: tests.errors(name) for name in reversed(MODELS)},
            unit,
            "Errors on all unseen cycles in free run.",
            f"Histogram and cumulative distribution of errors in {unit}.",
        ),
        figures.horizons(
            "cycles-horizons",
            accuracy.horizons,
            step_s,
            unit,
            "Error over the prediction horizon, including changes of direction.",
            f"RMSE in {unit} over the horizon.",
        ),
    )
    first_table, *others = _cycle_tables(accuracy, unit)
    return ReportSection("Mixed cycles", (first_table, Pictures(pictures), *others))


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
    made = result.model.provenance
    counts = [
        numbers.count(
            len(accuracy.tests),
            "unseen cycle" if direction == CYCLES else f"unseen {direction} test",
        )
        for direction, accuracy in result.accuracy.items()
    ]
    return Document(
        title=f"Validation of {made.name} ({made.date})" if made.name else "Validation of a model",
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
        summary=tuple(
            summary_table(
                direction,
                [(model_name(name), accuracy.models[name]) for name in in_table_order(accuracy.models)],
                result.unit,
            )
            for direction, accuracy in result.accuracy.items()
        ),
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
    """Return one section per direction, its subsections by the builders, and one for mixed cycles."""
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
    tables = [
        table
        for direction, channel in result.channels.items()
        for table in _direction_tables(direction, channel, unit)
    ]
    return tables if result.cycles is None else tables + _cycle_tables(result.cycles.accuracy, unit)


def _direction_tables(direction: str, channel: ChannelResult, unit: str) -> Iterator[Table]:
    accuracy = channel.accuracy
    yield from _accuracy_tables(direction, accuracy, unit)
    if channel.parameters is not None:
        title = "parameters of the physics model"
        yield parameter_table(direction, "parameters", title, channel.parameters).shown()
    if channel.characteristics is not None:
        yield speed_map_table(direction, channel.characteristics).shown()
        yield characteristic_table(direction, channel.characteristics).shown()
    if channel.load_scatter is not None:
        yield load_table(direction, channel.load_scatter).shown()
    if channel.paper_parameters is not None:
        title = "parameters of the paper's transfer function"
        yield parameter_table(direction, "paper-parameters", title, channel.paper_parameters).shown()
    if accuracy.bands is not None:
        yield band_table(direction, accuracy.bands, unit).shown()
    yield residual_table(direction, channel.residuals, unit)
    if channel.searches:
        yield search_table(direction, channel.searches, unit)


def _cycle_tables(accuracy: Accuracy, unit: str) -> list[Table]:
    bands = [] if accuracy.bands is None else [band_table(CYCLES, accuracy.bands, unit).shown()]
    return [*_accuracy_tables(CYCLES, accuracy, unit), *bands]


def _accuracy_tables(section: str, accuracy: Accuracy, unit: str) -> list[Table]:
    return [
        accuracy_table(section, accuracy, unit).shown(),
        horizon_table(section, accuracy, unit),
        single_test_table(section, accuracy, unit).shown(),
    ]
