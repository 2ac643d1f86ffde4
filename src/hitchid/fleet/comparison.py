"""`compare_fleet`: which machines stand out, which cohorts differ, and what changes with time."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hitchid._support.records import Value, short_repr
from hitchid._support.tables import Cell, DataTable
from hitchid.errors import InputError
from hitchid.fleet.ledger import newest
from hitchid.fleet.outliers import FEWEST as FEWEST_OF_OUTLIERS
from hitchid.fleet.outliers import (
    CohortEffect,
    FleetTrends,
    Outliers,
    compare_cohorts,
    find_outliers,
    fit_trends,
)
from hitchid.fleet.parameters import (
    DEAD_ZONE,
    GAIN,
    NAMES,
    FleetParameter,
    Kind,
    Metadata,
    estimates_of_row,
    kind_of,
)
from hitchid.fleet.populations import Hierarchy, Population, hierarchies_of, populations_of, selected
from hitchid.fleet.row import FAILED, Row
from hitchid.logs import DIRECTIONS

# Tables of a comparison of machines as data: one line for each machine and parameter.

COLUMNS = {
    "outliers": ("machine", "direction", "parameter", "value", "unit"),
    "machines": ("machine", "direction", "parameter", "unit", "estimate", "value"),
    "populations": ("direction", "parameter", "unit", "machines", "mean"),
    "cohorts": ("column", "category", "direction", "parameter"),
    "trends": ("machine", "direction", "parameter", "slope_per_year"),
    "failures": ("machine", "date", "cause", "message"),
    "not_compared": ("machine", "direction", "reason"),
}
"""Table to the columns that an empty one has."""


def comparison_tables(comparison: "FleetComparison") -> dict[str, DataTable]:
    """Return every table of a comparison, by name.

    `estimate`, `deviation`, slopes and their ends are of the logarithm where the column `logarithm` is true.
    """
    # `nonzero` goes by machine, then parameter: the order of the rows of the table.
    indices = (cells.tolist() for cells in np.nonzero(~np.isnan(comparison.estimates)))
    lines: dict[str, Iterable[Mapping[str, Cell]]] = {
        "outliers": (_line(comparison, *cell) for cell in comparison.outliers.ranking),
        "machines": (_line(comparison, *cell) for cell in zip(*indices, strict=True)),
        "populations": _populations(comparison),
        "cohorts": _cohorts(comparison),
        "trends": _trend_rows(comparison),
        "failures": (
            {"machine": row.machine, "date": row.date, "cause": row.cause, "message": row.message}
            for row in comparison.failed
        ),
        "not_compared": (left_out._asdict() for left_out in comparison.not_compared),
    }
    tables = {name: DataTable.of_rows(name, rows) for name, rows in lines.items()}
    # An empty table keeps its header, so that whoever reads its file finds the columns.
    return {
        name: table if len(table) else DataTable(name, COLUMNS[name], ()) for name, table in tables.items()
    }


def comparison_metrics(comparison: "FleetComparison") -> dict[str, object]:
    """Return the content of `comparison.json`: numbers of machines, and all tables but `machines`."""
    lines: dict[str, object] = {
        name: [dict(zip(table.columns, row, strict=True)) for row in table.rows]
        for name, table in comparison.tables.items()
        if name != "machines"
    }
    return {
        "machines": len(comparison.rows),
        "compared": len(comparison.machines),
        "failed": len(comparison.failed),
        "standing_out": list(comparison.standing_out),
        "false_discovery_rate": comparison.false_discovery_rate,
        "notices": list(comparison.notices),
        **lines,
    }


def _name(parameter: FleetParameter) -> dict[str, Cell]:
    return {
        "direction": parameter.direction,
        "parameter": parameter.name,
        "unit": parameter.unit,
        "logarithm": parameter.logarithmic,
    }


def _cell(value: float) -> float | None:
    """Return a number, or None where there is none."""
    return float(value) if np.isfinite(value) else None


def _line(comparison: "FleetComparison", machine: int, column: int) -> dict[str, Cell]:
    """Return what is known of one parameter of one machine."""
    outliers, parameter = comparison.outliers, comparison.parameters[column]
    estimate = comparison.estimates[machine, column]
    numbers = {
        "value": parameter.value(estimate),
        "estimate": estimate,
        "error": np.sqrt(comparison.covariances[machine, column, column]),
        "deviation": outliers.deviation[machine, column],
        "deviation_lower": outliers.lower[machine, column],
        "deviation_upper": outliers.upper[machine, column],
        "detectable": outliers.detectable[machine, column],
        "p_value": outliers.p_value[machine, column],
        "q_value": outliers.q_value[machine, column],
    }
    return {
        "machine": comparison.machines[machine],
        **_name(parameter),
        **{name: _cell(float(number)) for name, number in numbers.items()},
        "stands_out": bool(outliers.named[machine, column]),
    }


def _populations(comparison: "FleetComparison") -> Iterator[dict[str, Cell]]:
    for parameter, population in zip(comparison.parameters, comparison.populations, strict=True):
        numbers = {"mean": population.mean, "spread": population.spread}
        for name in ("mean_interval", "spread_interval", "prediction_interval"):
            lower, upper = getattr(population, name)
            short = name.removesuffix("_interval")
            numbers |= {f"{short}_lower": lower, f"{short}_upper": upper}
        yield {
            **_name(parameter),
            "machines": population.machines,
            **{name: _cell(number) for name, number in numbers.items()},
        }


def _cohorts(comparison: "FleetComparison") -> Iterator[dict[str, Cell]]:
    for effect in comparison.cohorts:
        labels = effect.labels or ("slope per unit",)
        for label, value, (lower, upper) in zip(labels, effect.values, effect.intervals, strict=True):
            yield {
                "column": effect.column,
                "category": label,
                **_name(comparison.parameters[effect.parameter]),
                "machines": effect.machines,
                "value": _cell(value),
                "lower": _cell(lower),
                "upper": _cell(upper),
                "p_value": _cell(effect.p_value),
                "q_value": _cell(effect.q_value),
            }


def _trend_rows(comparison: "FleetComparison") -> Iterator[dict[str, Cell]]:
    trends = comparison.trends
    if trends is None:
        return
    for line, column in np.argwhere(~np.isnan(trends.slopes)):
        numbers = {
            "slope_per_year": trends.slopes[line, column],
            "error": trends.errors[line, column],
            "lower": trends.lower[line, column],
            "upper": trends.upper[line, column],
            "p_value": trends.p_values[line, column],
            "q_value": trends.q_values[line, column],
        }
        yield {
            "machine": comparison.machines[int(trends.machines[line])],
            **_name(comparison.parameters[column]),
            **{name: _cell(float(number)) for name, number in numbers.items()},
            "is_named": bool(trends.q_values[line, column] <= comparison.false_discovery_rate),
        }


YEAR_S = 365.25 * 24 * 3600  # unit of time of the trends, s


class NotCompared(NamedTuple):
    """A machine of which one direction, or a parameter of it, is not compared, and why."""

    machine: str
    direction: str
    reason: str


@short_repr
@dataclass(frozen=True, eq=False)
class FleetComparison(Value):
    """Comparison of N machines in P parameters; estimates are logarithms for gains and load scatters.

    Attributes:
        rows: last result of each machine, failed ones too.
        machines: names of the machines that are compared, shape [N].
        parameters: of both directions, shape [P].
        kinds: direction to structure and units of the machines that are compared.
        estimates: shape [N, P], NaN where missing.
        covariances: of their errors, shape [N, P, P].
        populations: distribution of each parameter over machines, shape [P].
        hierarchies: direction to the parameters that its model comprises, and the model; without directions
            in which no parameter has three machines.
        outliers: each machine beside the others.
        cohorts: effects of the columns of the metadata.
        trends: slopes over years, of machines with results of several dates; None without any.
        not_compared: directions and parameters of machines that are left out.
        false_discovery_rate: of outliers, cohorts and trends.
        notices: on what could not be compared.
    """

    rows: tuple[Row, ...]
    machines: tuple[str, ...]
    parameters: tuple[FleetParameter, ...]
    kinds: Mapping[str, Kind]
    estimates: Float[np.ndarray, "n p"]
    covariances: Float[np.ndarray, "n p p"]
    populations: tuple[Population, ...]
    hierarchies: Mapping[str, tuple[tuple[int, ...], Hierarchy]]
    outliers: Outliers
    cohorts: tuple[CohortEffect, ...] = ()
    trends: FleetTrends | None = None
    not_compared: tuple[NotCompared, ...] = ()
    false_discovery_rate: float = 0.1
    notices: tuple[str, ...] = field(default=())

    @property
    def failed(self) -> tuple[Row, ...]:
        """Rows of the machines whose campaign could not be identified."""
        return tuple(row for row in self.rows if row.state == FAILED)

    @cached_property
    def standing_out(self) -> tuple[str, ...]:
        """Machines that stand out in a parameter, smallest p-value first."""
        return tuple(dict.fromkeys(self.machines[machine] for machine, _ in self.outliers.ranking))

    @cached_property
    def tables(self) -> dict[str, DataTable]:
        """Every table as data, by name: outliers, machines, populations, cohorts, trends, failures, …."""
        return comparison_tables(self)

    def column(self, direction: str, name: str) -> int | None:
        """Return the index of a parameter; None where it is not compared."""
        names = [(parameter.direction, parameter.name) for parameter in self.parameters]
        return names.index((direction, name)) if (direction, name) in names else None


def compare_fleet(
    rows: Iterable[Row], metadata: Metadata | None = None, *, false_discovery_rate: float = 0.1
) -> FleetComparison:
    """Return the comparison of the machines of a fleet.

    Gains of different structures are not comparable: in each direction, machines of the commonest structure
    and units are compared with each other, and the others are listed.

    Args:
        rows: of a store of results; of several dates of a machine the last is compared, all give its trend.
        metadata: properties of the machines, for cohorts.
        false_discovery_rate: expected share of sound ones among the machines that are named.

    Raises:
        InputError: there are no rows, or the rate is not between 0 and 1.
    """
    history = tuple(rows)
    if not history:
        raise InputError("rows: got none, expected a row for at least one machine")
    last = newest(history)
    # Before any statistics: a gain per ampere beside one per percent would be a machine that stands out.
    kinds = _commonest_kinds(last)
    compared = [row for row in last if any(_is_compared(row, kinds, direction) for direction in kinds)]
    estimates, covariances = _arrays(compared, kinds)
    # A parameter that no machine has would be columns of NaN in every table and figure.
    present = np.flatnonzero(np.any(~np.isnan(estimates), axis=0))
    every = [FleetParameter(mode, name, kind.unit(name)) for mode, kind in kinds.items() for name in NAMES]
    parameters = tuple(every[index] for index in present)
    estimates, covariances = selected(estimates, covariances, present)
    machines = tuple(row.machine for row in compared)
    hierarchies = hierarchies_of(parameters, estimates, covariances)
    columns = {} if metadata is None else metadata.of(machines)
    cohorts = compare_cohorts(estimates, covariances, columns) if columns and machines else ()
    return FleetComparison(
        rows=last,
        machines=machines,
        parameters=parameters,
        kinds=kinds,
        estimates=estimates,
        covariances=covariances,
        populations=populations_of(estimates, hierarchies),
        hierarchies=hierarchies,
        outliers=find_outliers(estimates, covariances, false_discovery_rate=false_discovery_rate),
        cohorts=cohorts,
        trends=_trends(history, machines, kinds, present),
        not_compared=tuple(_not_compared(last, kinds)),
        false_discovery_rate=false_discovery_rate,
        notices=(
            *_few(parameters, estimates),
            *([] if metadata is None else metadata.notices((row.machine for row in last), machines)),
            *(
                f"column '{column}' has no two categories of three machines, or no two numbers; "
                "no cohorts are compared by it"
                for column in columns
                if column not in {effect.column for effect in cohorts}
            ),
        ),
    )


def _commonest_kinds(rows: Sequence[Row]) -> dict[str, Kind]:
    kinds = {}
    for direction in DIRECTIONS:
        counts = Counter(kind_of(row, direction) for row in rows if direction in row.directions)
        if counts:
            # Of equally many the first by name: the order of the rows must not matter.
            kinds[direction] = min(counts, key=lambda kind: (-counts[kind], kind))
    return kinds


def _is_compared(row: Row, kinds: Mapping[str, Kind], direction: str) -> bool:
    return direction in row.directions and kind_of(row, direction) == kinds.get(direction)


def _not_compared(rows: Sequence[Row], kinds: Mapping[str, Kind]) -> Iterable[NotCompared]:
    """Yield what is left out of the comparison, and why."""
    for row in rows:
        for direction, figures in row.directions.items():
            kind, compared = kind_of(row, direction), kinds[direction]
            if kind.structure != compared.structure:
                reason = f"structure {kind.structure}; compared is {compared.structure}"
                yield NotCompared(row.machine, direction, reason)
            elif kind != compared:
                own, others = (f"{k.displacement_unit} and {k.command_unit}" for k in (kind, compared))
                yield NotCompared(row.machine, direction, f"units {own}; compared are {others}")
            else:
                if not figures.gain_error:
                    yield NotCompared(row.machine, direction, "the tests do not determine the gain")
                if not figures.dead_zone_error:
                    yield NotCompared(row.machine, direction, "the dead zone was given, not identified")


def _arrays(rows: Sequence[Row], kinds: Mapping[str, Kind]) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates and covariances of all parameters of all directions, NaN where missing."""
    size = len(NAMES) * len(kinds)
    estimates = np.full((len(rows), size), np.nan)
    covariances = np.zeros((len(rows), size, size))
    for number, row in enumerate(rows):
        for first, direction in zip(range(0, size, len(NAMES)), kinds, strict=True):
            block = slice(first, first + len(NAMES))
            if _is_compared(row, kinds, direction):
                figures = estimates_of_row(row.directions[direction])
                estimates[number, block], covariances[number, block, block] = figures
    covariances[np.isnan(estimates)] = np.nan
    covariances.swapaxes(1, 2)[np.isnan(estimates)] = np.nan
    return estimates, covariances


def _trends(
    history: Sequence[Row], machines: Sequence[str], kinds: Mapping[str, Kind], columns: np.ndarray
) -> FleetTrends | None:
    """Return slopes in the parameter's unit per year; None without a machine with results of two dates."""
    numbers = {machine: number for number, machine in enumerate(machines)}
    dated: dict[tuple[str, str], Row] = {}
    for row in history:
        if row.state != FAILED and row.date and row.machine in numbers:
            dated[row.machine, row.date] = row  # one result of a date: the same logs give no trend
    dates = Counter(machine for machine, _ in dated)
    rows = [row for row in dated.values() if dates[row.machine] > 1]
    if not rows:
        return None
    times = np.array([datetime.fromisoformat(row.date).timestamp() for row in rows]) / YEAR_S
    estimates, covariances = selected(*_arrays(rows, kinds), columns)
    return fit_trends(np.array([numbers[row.machine] for row in rows]), times, estimates, covariances)


def _few(parameters: Sequence[FleetParameter], estimates: np.ndarray) -> Iterable[str]:
    """Yield a notice on gains and dead zones that too few machines have for one to stand out."""
    counts = np.sum(~np.isnan(estimates), axis=0)
    few = [
        f"{parameter.name} of {parameter.direction} ({count})"
        for parameter, count in zip(parameters, counts, strict=True)
        if parameter.name in (GAIN, DEAD_ZONE) and count < FEWEST_OF_OUTLIERS
    ]
    if few:
        yield f"no machine can stand out where fewer than {FEWEST_OF_OUTLIERS} are compared: {', '.join(few)}"
