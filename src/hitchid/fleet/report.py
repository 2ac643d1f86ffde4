"""Report of a fleet: which machines stand out, cohorts, trends, failures, and what it took."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from hitchid._support import numbers
from hitchid._support.tables import Cell, DataTable
from hitchid.fleet import figures as figures
from hitchid.fleet.comparison import FleetComparison, comparison_metrics
from hitchid.fleet.findings import (
    amount,
    detectable,
    differences,
    fleet_findings,
    q_text,
    signed_amount,
    signed_range,
)
from hitchid.fleet.outliers import FleetTrends
from hitchid.fleet.parameters import FleetParameter, listed
from hitchid.fleet.row import Row
from hitchid.report import (
    Block,
    Document,
    Picture,
    Pictures,
    ReportSection,
    Table,
    Text,
    command_section,
    sentence,
)

MOST_LINES = 100  # of a table of machines; chosen: the data tables have all
MEGABYTE = 1e6  # bytes
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
    """Return the report of a fleet, from the store of the results that a command line compared."""
    machines = numbers.count(len(comparison.rows), "machine")
    return Document(
        title=f"Fleet of {machines}",
        subtitle=f"{source}; false discovery rate {100 * comparison.false_discovery_rate:g} %",
        verdict=fleet_findings(comparison),
        notices=tuple(map(sentence, comparison.notices)),
        sections=tuple(_sections(comparison, command)),
        summary=(_population_table(comparison, SUMMARY),) if comparison.machines else (),
        data=comparison_metrics(comparison),
        data_tables=comparison.tables,
    )


def _sections(comparison: FleetComparison, command: str) -> Iterator[ReportSection]:
    if comparison.machines:
        yield _outliers(comparison)
        yield _machines(comparison)
    if comparison.cohorts:
        yield ReportSection("Cohorts", (Text(COHORTS), _cohort_table(comparison)))
    if comparison.trends is not None:
        yield ReportSection("Trends", (Text(TRENDS), _trend_table(comparison, comparison.trends)))
    if comparison.failed:
        by_cause = _most_frequent_first((row.cause, row) for row in comparison.failed)
        lines = (
            (cause, str(len(rows)), listed([row.machine for row in rows]), rows[0].message)
            for cause, rows in by_cause
        )
        header = ("cause", "machines", "names", "message of the first")
        yield ReportSection("Failures", (Table("By cause", header, tuple(lines)),))
    if comparison.not_compared:
        pairs = (((left.direction, left.reason), left.machine) for left in comparison.not_compared)
        by_reason = _most_frequent_first(pairs)
        lines = ((*key, str(len(machines)), listed(machines)) for key, machines in by_reason)
        header = ("direction", "reason", "machines", "names")
        yield ReportSection("Not compared", (Table("By reason", header, tuple(lines)),))
    if any(row.cost is not None for row in comparison.rows):
        yield ReportSection("Cost", (_cost_table(comparison.rows),))
    yield command_section(command)


def _outliers(comparison: FleetComparison) -> ReportSection:
    blocks: list[Block] = [Text(EXPLANATION)]
    if comparison.standing_out:
        blocks += [_outlier_table(comparison), Text(INTERVALS)]
    if text := detectable(comparison):
        blocks.append(Text(text))
    if figures.verdict_rows(comparison)[0]:
        others = figures.shown_machines(comparison)[1]
        left_out = f" The other {len(others)} machines are left out." if others else ""
        picture = Picture(
            "verdicts",
            figures.verdicts(comparison),
            f"Parameters in which machines are higher (▲) or lower (▼) than the others.{left_out}",
            f"Grid of machines and parameters; {len(comparison.standing_out)} machines stand out.",
            wide=True,
            data=_columns(comparison.tables["outliers"]),
        )
        blocks.append(Pictures((picture,)))
    return ReportSection("Machines that stand out", tuple(blocks))


def _machines(comparison: FleetComparison) -> ReportSection:
    directions = dict.fromkeys(parameter.direction for parameter in comparison.parameters)
    pictures = [_forest(comparison, direction) for direction in directions]
    if figures.directions_with_both(comparison):
        few = len(comparison.machines) <= figures.MOST_ROWS
        whose = "each machine" if few else "the machines that stand out"
        many = len(comparison.machines) > figures.MOST_POINTS
        thinned = f" Of the machines like the others at most {figures.MOST_POINTS} are drawn." if many else ""
        pictures += [
            Picture(
                "gain-and-dead-zone",
                figures.scatter(comparison),
                f"Gain over dead zone. Thin ellipses: 95 % of the errors of {whose}; thick ellipse: 95 % of "
                f"the machines, without errors.{thinned}",
                "Gain over dead zone of the machines, with ellipses of their errors and of the distribution.",
                wide=True,
            ),
            Picture(
                "speeds",
                figures.speed_fan(comparison),
                "Steady speed over command of all machines, gain · (command \N{MINUS SIGN} dead zone): what "
                "nonlinearities of the structure add is left out. Pointed out: machines that stand out in "
                f"gain or dead zone.{thinned}",
                "Steady speed over command of all machines, with those that stand out in gain or dead zone.",
                wide=True,
            ),
        ]
    kinds = "; ".join(
        f"{direction}: {kind.structure} in {kind.unit('gain')}"
        for direction, kind in comparison.kinds.items()
    )
    blocks = (Text(KINDS.format(kinds=kinds)), _population_table(comparison), Pictures(tuple(pictures)))
    return ReportSection("Machines beside each other", blocks)


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


def _columns(table: DataTable, direction: str = "") -> dict[str, list[Cell]]:
    """Return the columns of a table, of one direction where it is given."""
    index = table.columns.index("direction")
    rows = [row for row in table.rows if not direction or row[index] == direction]
    return {name: [row[column] for row in rows] for column, name in enumerate(table.columns)}


# Tables: machines that stand out, populations, cohorts, trends, failures, costs.


def _outlier_table(comparison: FleetComparison) -> Table:
    """Return the parameters in which machines stand out, smallest p-value first, at most a hundred."""
    outliers = comparison.outliers
    header = ("machine", "parameter", "value", "beside the others", "interval", "q")
    rows = []
    for cell in outliers.ranking[:MOST_LINES]:
        machine, column = cell
        parameter = comparison.parameters[column]
        deviation, lower, upper = differences(
            parameter, cell, outliers.deviation, outliers.lower, outliers.upper
        )
        error = float(np.sqrt(comparison.covariances[machine, column, column]))
        value = float(parameter.value(comparison.estimates[cell]))
        # The error of a logarithm is relative.
        text = numbers.with_error(value, value * error if parameter.logarithmic else error)
        rows.append(
            (
                comparison.machines[machine],
                _name(parameter),
                numbers.with_unit(f"({text})" if "±" in text else text, parameter.unit),
                signed_amount(parameter, deviation),
                signed_range(parameter, lower, upper),
                _q(outliers.q_value[cell]),
            )
        )
    return Table("Differences, most certain first", header, tuple(rows))


POPULATION = ("parameter", "machines", "mean", "95 % interval", "spread", "95 % of the machines")


def _population_table(comparison: FleetComparison, columns: tuple[str, ...] = POPULATION) -> Table:
    """Return mean and spread of each parameter over machines, all columns or some."""
    rows = []
    for parameter, population in zip(comparison.parameters, comparison.populations, strict=True):
        values = (
            _value(parameter, population.mean),
            _ends(parameter, population.mean_interval),
            amount(parameter, population.spread),
            _ends(parameter, population.prediction_interval),
        )
        shown = ("",) * len(values) if np.isnan(population.mean) else values
        cells = (_name(parameter), str(population.machines), *shown)
        row: dict[str, str] = dict(zip(POPULATION, cells, strict=True))
        rows.append(tuple(row[column] for column in columns))
    return Table("Distribution over machines", columns, tuple(rows))


def _cohort_table(comparison: FleetComparison) -> Table:
    """Return the mean of each category, or the slope over a column of numbers, smallest p-value first."""
    rows = []
    for effect in sorted(comparison.cohorts, key=lambda effect: effect.p_value):
        parameter = comparison.parameters[effect.parameter]
        labels = effect.labels or ("for each unit",)
        for label, value, interval in zip(labels, effect.values, effect.intervals, strict=True):
            if effect.labels:
                cells = _value(parameter, value), _ends(parameter, interval)
            else:
                cells = _slope(parameter, value, interval)
            rows.append((effect.column, label, _name(parameter), *cells, _q(effect.q_value)))
    header = ("column", "category", "parameter", "mean or slope", "95 % interval", "q")
    return Table("Means and slopes", header, tuple(rows[:MOST_LINES]))


def _trend_table(comparison: FleetComparison, trends: FleetTrends) -> Table:
    """Return the slope of each parameter of the fleet and of the machines that change, per year."""
    rows = []
    for column, parameter in enumerate(comparison.parameters):
        if not np.isnan(trends.fleet_slopes[column]):
            slope = _slope(parameter, trends.fleet_slopes[column], trends.fleet_intervals[column])
            rows.append(("all machines", _name(parameter), *slope, ""))
    lines = {int(machine): line for line, machine in enumerate(trends.machines)}
    for machine, column in trends.ranking[:MOST_LINES]:
        cell, parameter = (lines[machine], column), comparison.parameters[column]
        if trends.q_values[cell] <= comparison.false_discovery_rate:
            slope = _slope(parameter, trends.slopes[cell], (trends.lower[cell], trends.upper[cell]))
            rows.append((comparison.machines[machine], _name(parameter), *slope, _q(trends.q_values[cell])))
    header = ("machine", "parameter", "change a year", "95 % interval", "q")
    return Table("Changes a year", header, tuple(rows))


Key = TypeVar("Key", bound="str | tuple[str, ...]")
Item = TypeVar("Item")


def _most_frequent_first(pairs: Iterable[tuple[Key, Item]]) -> list[tuple[Key, list[Item]]]:
    groups: dict[Key, list[Item]] = {}
    for key, item in pairs:
        groups.setdefault(key, []).append(item)
    return sorted(groups.items(), key=lambda group: (-len(group[1]), group[0]))


def _cost_table(rows: Sequence[Row]) -> Table:
    """Return what the identifications took: median and 95 % quantile of a machine, and the sum."""
    costs = [row.cost for row in rows if row.cost is not None]
    quantities = (
        ("elapsed time / s", [cost.seconds for cost in costs], True),
        ("core-seconds / s", [cost.core_seconds for cost in costs], True),
        ("read / MB", [cost.bytes_read / MEGABYTE for cost in costs], True),
        ("written / MB", [cost.bytes_written / MEGABYTE for cost in costs], True),
        ("largest memory of the worker / MB", [cost.peak_bytes / MEGABYTE for cost in costs], False),
    )
    lines = (
        (
            name,
            *(numbers.digits(float(np.quantile(values, share))) for share in (0.5, 0.95)),
            numbers.digits(sum(values)) if is_sum else "",
        )
        for name, values, is_sum in quantities
        if values
    )
    title = f"Cost of {numbers.count(len(costs), 'machine')}"
    return Table(title, ("quantity", "median", "95 % quantile", "sum"), tuple(lines))


def _name(parameter: FleetParameter) -> str:
    return f"{parameter.direction}: {parameter.name}"


def _value(parameter: FleetParameter, estimate: float) -> str:
    return numbers.with_unit(numbers.digits(float(parameter.value(estimate))), parameter.unit)


def _q(q_value: float) -> str:
    return q_text(float(q_value)).removeprefix("q ").removeprefix("= ")


def _ends(parameter: FleetParameter, interval: tuple[float, float]) -> str:
    lower, upper = (float(parameter.value(end)) for end in interval)
    return numbers.interval((lower, upper))


def _slope(
    parameter: FleetParameter, slope: float, interval: Sequence[float] | np.ndarray
) -> tuple[str, str]:
    """Return a slope and its interval, for each unit of time or of a column."""
    lower, upper = (float(parameter.difference(end)) for end in interval)
    return signed_amount(parameter, float(parameter.difference(slope))), signed_range(parameter, lower, upper)
