"""Tables of a comparison of machines as data: one line for each machine and parameter."""

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from hitchid._support.data_table import Cell, DataTable
from hitchid.fleet.parameters import FleetParameter

if TYPE_CHECKING:
    from hitchid.fleet.comparison import FleetComparison

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
    lines: dict[str, Iterable[Mapping[str, Cell]]] = {
        "outliers": _outliers(comparison),
        "machines": _machines(comparison),
        "populations": _populations(comparison),
        "cohorts": _cohorts(comparison),
        "trends": _trends(comparison),
        "failures": (
            {"machine": row.machine, "date": row.date, "cause": row.cause, "message": row.message}
            for row in comparison.failed
        ),
        "not_compared": (each._asdict() for each in comparison.not_compared),
    }
    tables = {name: DataTable.of_rows(name, rows) for name, rows in lines.items()}
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


def _outliers(comparison: "FleetComparison") -> Iterator[dict[str, Cell]]:
    return (_line(comparison, machine, column) for machine, column in comparison.outliers.ranking)


def _machines(comparison: "FleetComparison") -> Iterator[dict[str, Cell]]:
    cells = np.argwhere(~np.isnan(comparison.estimates))
    return (_line(comparison, int(machine), int(column)) for machine, column in cells)


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


def _trends(comparison: "FleetComparison") -> Iterator[dict[str, Cell]]:
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
