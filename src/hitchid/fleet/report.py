"""Report of a fleet: which machines stand out, cohorts, trends, failures, and what it took."""

from collections.abc import Iterator

from hitchid._support.tables import Cell, DataTable
from hitchid.fleet import figures as figures
from hitchid.fleet import tables as tables
from hitchid.fleet.comparison import FleetComparison, comparison_metrics
from hitchid.fleet.findings import detectable, fleet_findings
from hitchid.report import numbers
from hitchid.report.document import Block, Document, Picture, Pictures, ReportSection, Table, Text, sentence

SUMMARY = ("parameter", "machines", "mean", "spread")  # columns in a terminal
EXPLANATION = (
    "Each machine is compared with all others: its estimate with their mean, in terms of its error, of the "
    "spread between machines and of the error of the mean. A machine stands out where that is unlikely "
    "enough that of those named at most the stated share, the false discovery rate, is expected to be sound. "
    "q is the smallest rate at which the machine is named."
)
INTERVALS = (
    "On average the share of these intervals that do not contain the difference is at most the false "
    "discovery rate, although the largest differences were selected."
)
KINDS = (
    "Gains of different structures or units are not comparable. In each direction the machines with the "
    "commonest structure and units are compared: {kinds}."
)
COHORTS = (
    "Means of the categories with at least three machines, or the change for each unit of a column of "
    "numbers. q is over all columns and parameters. A cohort says what goes together, not what is the cause."
)
TRENDS = "Slopes of lines through the results of several dates, weighted by their errors."


def fleet_report(comparison: FleetComparison, *, source: str, command: str = "") -> Document:
    """Return the report of a fleet.

    Args:
        comparison: of the machines.
        source: store of the results.
        command: the command line that wrote the report.
    """
    machines = numbers.count(len(comparison.rows), "machine")
    return Document(
        title=f"Fleet of {machines}",
        subtitle=f"{source}; false discovery rate {100 * comparison.false_discovery_rate:g} %",
        verdict=fleet_findings(comparison),
        notices=tuple(map(sentence, comparison.notices)),
        sections=tuple(_sections(comparison, command)),
        summary=tuple(_summary(comparison)),
        data=comparison_metrics(comparison),
        data_tables=comparison.tables,
    )


def _sections(comparison: FleetComparison, command: str) -> Iterator[ReportSection]:
    if comparison.machines:
        yield _outliers(comparison)
        yield _machines(comparison)
    if comparison.cohorts:
        yield ReportSection("Cohorts", (Text(COHORTS), tables.cohort_table(comparison)))
    if comparison.trends is not None:
        yield ReportSection("Trends", (Text(TRENDS), tables.trend_table(comparison, comparison.trends)))
    if comparison.failed:
        yield ReportSection("Failures", (tables.failure_table(comparison.failed),))
    if comparison.not_compared:
        yield ReportSection("Not compared", (tables.not_compared_table(comparison),))
    if any(row.cost is not None for row in comparison.rows):
        yield ReportSection("Cost", (tables.cost_table(comparison.rows),))
    yield ReportSection("How to reproduce", (Table("Origin", ("what", "value"), (("command", command),)),))


def _outliers(comparison: FleetComparison) -> ReportSection:
    blocks: list[Block] = [Text(EXPLANATION)]
    if comparison.standing_out:
        blocks += [tables.outlier_table(comparison), Text(INTERVALS)]
    if text := detectable(comparison):
        blocks.append(Text(text))
    if figures.verdict_rows(comparison)[0]:
        blocks.append(Pictures((_verdicts(comparison),)))
    return ReportSection("Machines that stand out", tuple(blocks))


def _machines(comparison: FleetComparison) -> ReportSection:
    pictures = [_forest(comparison, direction) for direction in _directions(comparison)]
    if figures.directions_with_both(comparison):
        pictures += [_scatter(comparison), _speed_fan(comparison)]
    kinds = "; ".join(
        f"{direction}: {kind.structure} in {kind.unit('gain')}"
        for direction, kind in comparison.kinds.items()
    )
    blocks = (Text(KINDS.format(kinds=kinds)), tables.population_table(comparison), Pictures(tuple(pictures)))
    return ReportSection("Machines beside each other", blocks)


def _directions(comparison: FleetComparison) -> list[str]:
    return list(dict.fromkeys(parameter.direction for parameter in comparison.parameters))


def _verdicts(comparison: FleetComparison) -> Picture:
    others = figures.shown_machines(comparison)[1]
    left_out = f" The other {len(others)} machines are left out." if others else ""
    return Picture(
        "verdicts",
        figures.verdicts(comparison),
        f"Parameters in which machines are higher (▲) or lower (▼) than the others.{left_out}",
        f"Grid of machines and parameters; {len(comparison.standing_out)} machines stand out.",
        wide=True,
        data=_columns(comparison.tables["outliers"]),
    )


def _forest(comparison: FleetComparison, direction: str) -> Picture:
    others = figures.shown_machines(comparison)[1]
    left_out = (
        f" The last row has the quantiles of the estimates of the other {len(others)}: 95 %, half, median."
        if others
        else ""
    )
    return Picture(
        f"{direction}-machines",
        figures.forest(comparison, direction),
        f"{direction.capitalize()}: estimates with 95 % intervals; triangles stand out. Line and dark band: "
        f"mean over machines with its 95 % interval; light band: 95 % of the machines.{left_out}",
        f"Parameters of {direction} of each machine with 95 % intervals and the distribution over machines.",
        wide=True,
        data=_columns(comparison.tables["machines"], direction),
    )


def _scatter(comparison: FleetComparison) -> Picture:
    few = len(comparison.machines) <= figures.MOST_ROWS
    whose = "each machine" if few else "the machines that stand out"
    return Picture(
        "gain-and-dead-zone",
        figures.scatter(comparison),
        f"Gain over dead zone. Thin ellipses: 95 % of the errors of {whose}; thick ellipse: 95 % of the "
        f"machines, without errors.{_thinned(comparison)}",
        "Gain over dead zone of the machines, with ellipses of their errors and of the distribution.",
        wide=True,
    )


def _speed_fan(comparison: FleetComparison) -> Picture:
    return Picture(
        "speeds",
        figures.speed_fan(comparison),
        "Steady speed over command of all machines, gain · (command \N{MINUS SIGN} dead zone): what "
        "nonlinearities of the structure add is left out. Pointed out: machines that stand out in gain or "
        f"dead zone.{_thinned(comparison)}",
        "Steady speed over command of all machines, with those that stand out in gain or dead zone.",
        wide=True,
    )


def _thinned(comparison: FleetComparison) -> str:
    """Return that not all machines are drawn; empty if all are."""
    many = len(comparison.machines) > figures.MOST_POINTS
    return f" Of the machines like the others at most {figures.MOST_POINTS} are drawn." if many else ""


def _columns(table: DataTable, direction: str = "") -> dict[str, list[Cell]]:
    """Return the columns of a table, of one direction where it is given."""
    place = table.columns.index("direction")
    rows = [row for row in table.rows if not direction or row[place] == direction]
    return {name: [row[column] for row in rows] for column, name in enumerate(table.columns)}


def _summary(comparison: FleetComparison) -> Iterator[Table]:
    if comparison.machines:
        full = tables.population_table(comparison)
        columns = [full.header.index(name) for name in SUMMARY]
        rows = tuple(tuple(row[column] for column in columns) for row in full.rows)
        yield Table(full.title, SUMMARY, rows)
