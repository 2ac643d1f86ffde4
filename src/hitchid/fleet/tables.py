"""Tables of a fleet: machines that stand out, populations, cohorts, trends, failures, costs."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from hitchid.fleet.comparison import FleetComparison
from hitchid.fleet.findings import amount, q_text, signed_amount, signed_range
from hitchid.fleet.outliers import CohortEffect, FleetTrends
from hitchid.fleet.parameters import FleetParameter
from hitchid.fleet.populations import Population
from hitchid.fleet.row import Row
from hitchid.report import numbers
from hitchid.report.document import Table

MOST_ROWS = 100  # of a table of machines; chosen: the data tables have all
MOST_NAMES = 5  # machines of one cause or reason that are named; chosen
MEGABYTE = 1e6  # bytes


def outlier_table(comparison: FleetComparison) -> Table:
    """Return the parameters in which machines stand out, smallest p-value first, at most a hundred."""
    outliers = comparison.outliers
    header = ("machine", "parameter", "value", "beside the others", "interval", "q")
    rows = []
    for machine, column in outliers.ranking[:MOST_ROWS]:
        parameter = comparison.parameters[column]
        deviation, lower, upper = (
            float(parameter.difference(each[machine, column]))
            for each in (outliers.deviation, outliers.lower, outliers.upper)
        )
        rows.append(
            (
                comparison.machines[machine],
                _name(parameter),
                _with_error(comparison, machine, column),
                signed_amount(parameter, deviation),
                signed_range(parameter, lower, upper),
                _q(outliers.q_value[machine, column]),
            )
        )
    return Table("Differences, most certain first", header, tuple(rows))


def population_table(comparison: FleetComparison) -> Table:
    """Return mean and spread of each parameter over machines."""
    header = ("parameter", "machines", "mean", "95 % interval", "spread", "95 % of the machines")
    pairs = zip(comparison.parameters, comparison.populations, strict=True)
    rows = tuple(_population_row(parameter, population) for parameter, population in pairs)
    return Table("Distribution over machines", header, rows)


def _population_row(parameter: FleetParameter, population: Population) -> tuple[str, ...]:
    known = not np.isnan(population.mean)
    values = (
        _value(parameter, population.mean),
        _ends(parameter, population.mean_interval),
        amount(parameter, population.spread),
        _ends(parameter, population.prediction_interval),
    )
    return (_name(parameter), str(population.machines), *(values if known else ("",) * len(values)))


def cohort_table(comparison: FleetComparison) -> Table:
    """Return the mean of each category, or the slope over a column of numbers, smallest p-value first."""
    effects = sorted(comparison.cohorts, key=lambda effect: effect.p_value)
    rows = [row for effect in effects for row in _cohort_rows(comparison, effect)]
    header = ("column", "category", "parameter", "mean or slope", "95 % interval", "q")
    return Table("Means and slopes", header, tuple(rows[:MOST_ROWS]))


def _cohort_rows(comparison: FleetComparison, effect: CohortEffect) -> Iterator[tuple[str, ...]]:
    parameter = comparison.parameters[effect.parameter]
    labels = effect.labels or ("for each unit",)
    for label, value, interval in zip(labels, effect.values, effect.intervals, strict=True):
        if effect.labels:
            cells = _value(parameter, value), _ends(parameter, interval)
        else:
            cells = _slope(parameter, value, interval)
        yield effect.column, label, _name(parameter), *cells, _q(effect.q_value)


def trend_table(comparison: FleetComparison, trends: FleetTrends) -> Table:
    """Return the slope of each parameter of the fleet and of the machines that change, per year."""
    rows = []
    for column, parameter in enumerate(comparison.parameters):
        if not np.isnan(trends.fleet_slopes[column]):
            slope = _slope(parameter, trends.fleet_slopes[column], trends.fleet_intervals[column])
            rows.append(("all machines", _name(parameter), *slope, ""))
    lines = {int(machine): line for line, machine in enumerate(trends.machines)}
    for machine, column in trends.ranking[:MOST_ROWS]:
        cell, parameter = (lines[machine], column), comparison.parameters[column]
        if trends.q_values[cell] <= comparison.false_discovery_rate:
            slope = _slope(parameter, trends.slopes[cell], (trends.lower[cell], trends.upper[cell]))
            rows.append((comparison.machines[machine], _name(parameter), *slope, _q(trends.q_values[cell])))
    header = ("machine", "parameter", "change a year", "95 % interval", "q")
    return Table("Changes a year", header, tuple(rows))


def failure_table(rows: Sequence[Row]) -> Table:
    """Return the failed machines by cause, the most frequent first.

    Args:
        rows: of failed machines.
    """
    causes: dict[str, list[Row]] = {}
    for row in rows:
        causes.setdefault(row.cause, []).append(row)
    ordered = sorted(causes.items(), key=lambda item: (-len(item[1]), item[0]))
    lines = (
        (cause, str(len(own)), _listed(row.machine for row in own), own[0].message) for cause, own in ordered
    )
    return Table("By cause", ("cause", "machines", "names", "message of the first"), tuple(lines))


def not_compared_table(comparison: FleetComparison) -> Table:
    """Return what is left out of the comparison by direction and reason, the most frequent first."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for each in comparison.not_compared:
        reasons.setdefault((each.direction, each.reason), []).append(each.machine)
    ordered = sorted(reasons.items(), key=lambda item: (-len(item[1]), item[0]))
    rows = (
        (direction, reason, str(len(machines)), _listed(machines))
        for (direction, reason), machines in ordered
    )
    return Table("By reason", ("direction", "reason", "machines", "names"), tuple(rows))


def cost_table(rows: Sequence[Row]) -> Table:
    """Return what the identifications took: median and 95 % quantile of a machine, and the sum.

    Args:
        rows: of all machines; those without cost are left out.
    """
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
            _sum(values, is_sum),
        )
        for name, values, is_sum in quantities
        if values
    )
    title = f"Cost of {numbers.count(len(costs), 'machine')}"
    return Table(title, ("quantity", "median", "95 % quantile", "sum"), tuple(lines))


def _sum(values: Sequence[float], is_sum: bool) -> str:
    return numbers.digits(sum(values)) if is_sum else ""


def _name(parameter: FleetParameter) -> str:
    return f"{parameter.direction}: {parameter.name}"


def _value(parameter: FleetParameter, estimate: float) -> str:
    return numbers.with_unit(numbers.digits(float(parameter.value(estimate))), parameter.unit)


def _with_error(comparison: FleetComparison, machine: int, column: int) -> str:
    """Return the value of a parameter of a machine with its standard error."""
    parameter = comparison.parameters[column]
    error = float(np.sqrt(comparison.covariances[machine, column, column]))
    value = float(parameter.value(comparison.estimates[machine, column]))
    text = numbers.with_error(value, value * error if parameter.logarithmic else error)
    return numbers.with_unit(f"({text})" if "±" in text else text, parameter.unit)


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


def _listed(names: Iterable[str]) -> str:
    """Return the first names, and how many more there are."""
    every = list(names)
    more = len(every) - MOST_NAMES
    return ", ".join(every[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
