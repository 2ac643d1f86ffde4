"""Parameters of one direction with their intervals, operating characteristics, valve, dead zone."""

from collections.abc import Iterator

from hitchid.model import Characteristics, Estimates, LoadScatter
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report import figure_data, figures
from hitchid.report.characteristics import characteristic_sentences
from hitchid.report.document import Block, Picture, Pictures, ReportSection, Table, Text, sentence
from hitchid.report.sections.context import DirectionContext
from hitchid.report.sections.transfer_function import transfer_function
from hitchid.report.tables import characteristic_tables, load_table, parameter_table
from hitchid.report.trace_file import TracedDeadZone


def parameters(context: DirectionContext) -> ReportSection:
    """Return the section on parameters with their intervals, the valve, and the dead zone."""
    result, data = context.result, context.data
    blocks: list[Block] = [*transfer_function(data.channel.benchmark, data.unit, data.command_unit)]
    pictures = [_valve_map(context)]
    for estimates, model, name in (
        (result.parameters, "benchmark", "intervals"),
        (result.paper_parameters, "paper's transfer function", "paper-intervals"),
    ):
        if estimates is not None and estimates.parameters:
            title = f"parameters of the {model}"
            blocks.append(parameter_table(f"{context.direction}: {title}", estimates))
            pictures += _intervals(context.figure_name(name), title, estimates)
    if result.characteristics is not None:
        blocks += _characteristic_blocks(context.direction, result.characteristics)
    if result.load_scatter is not None:
        blocks.append(load_table(context.direction, result.load_scatter))
        pictures.append(_loads(context, result.load_scatter))
    pictures += _dead_zone(context)
    return ReportSection("Parameters", (*blocks, Pictures(tuple(pictures))))


def _characteristic_blocks(direction: str, characteristics: Characteristics) -> list[Text | Table]:
    sentences = map(sentence, characteristic_sentences(characteristics, direction))
    return [Text(" ".join(sentences)), *characteristic_tables(direction, characteristics)]


def _valve_map(context: DirectionContext) -> Picture:
    data = context.data
    return Picture(
        context.figure_name("valve"),
        figures.valve_map(data.valve_map, data.unit, data.command_unit),
        "Valve map: speed over command, of tests once it has settled: four lags after a change of the "
        "command. Points below the dead zone are decaying motion.",
        f"Speed in {data.unit}/s over command in {data.command_unit}: benchmark, tests and ramps.",
        data=figure_data.valve_map(data.valve_map, data.unit, data.command_unit),
    )


def _intervals(name: str, title: str, estimates: Estimates) -> Iterator[Picture]:
    assessed = [estimate for estimate in estimates.parameters if estimate.method != NOT_ASSESSED]
    if not assessed:
        return
    yield Picture(
        name,
        figures.intervals(assessed),
        (
            f"{title.capitalize()}: estimate and 95 % interval, each on its own scale; thin "
            "line: bootstrap interval. Grey: not determined by the tests."
        ),
        "; ".join(f"{estimate.symbol}: {estimate.verdict}" for estimate in assessed),
        data=figure_data.intervals(assessed),
    )


def _loads(context: DirectionContext, load_scatter: LoadScatter) -> Picture:
    return Picture(
        context.figure_name("loads"),
        figures.loads(load_scatter),
        (
            "Speed of each identification test above the model's, as a load that nobody measures would make "
            "it, with its 95 % interval, the slowest test below; grey: not determined; grey band: "
            "± the scatter between tests."
        ),
        sentence(load_scatter.sentence),
        data=figure_data.loads(load_scatter),
    )


def _dead_zone(context: DirectionContext) -> Iterator[Picture]:
    data, trace = context.data, context.trace
    if not data.ramps or trace is None or not trace.dead_zone.value > 0:
        return
    zone = trace.dead_zone
    shown = (data.ramps, context.direction, zone.value, zone.spread, data.unit, data.command_unit)
    yield Picture(
        context.figure_name("dead-zone"),
        figures.dead_zone(*shown),
        _dead_zone_caption(zone),
        f"Travel of the piston over command on {len(data.ramps)} ramps; dead zone {zone.value:.4g} "
        f"{data.command_unit}.",
        data=figure_data.dead_zone(*shown),
    )


def _dead_zone_caption(zone: TracedDeadZone) -> str:
    """Return the origin of a dead zone, as a caption."""
    if zone.origin == "ramps":
        return f"Dead zone from {zone.count} slow ramps, ± its spread: the command at which motion starts."
    if zone.origin == "tests":
        return f"Dead zone from {zone.count} dynamic tests, ± its standard error; the ramps were not used."
    return "Dead zone as given; the ramps were not used."
