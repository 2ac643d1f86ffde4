"""Tables of parameters with their intervals, of operating characteristics, and of loads of tests."""

from dataclasses import replace
from typing import Any

from hitchid._support import numbers
from hitchid._support.tables import (
    Column,
    Faint,
    RecordTable,
    field_column,
    field_of,
    interval_columns,
    number_column,
)
from hitchid.model import Characteristics, Estimate, Estimates, LoadOfTest, LoadScatter, Quantity
from hitchid.model.estimates import NOT_ASSESSED


def estimate_text(result: Estimate | Quantity) -> str:
    """Return a value with its standard error; only the value, faint, if it is not determined."""
    if result.determined and _is_assessed(result):
        return numbers.with_error(result.value, field_of("error")(result))
    return determined_text(result.value, determined=result.determined)


def determined_text(value: float, *, determined: bool) -> str:
    """Return a value with four digits, faint if the tests do not determine it."""
    return numbers.digits(value) if determined else Faint(numbers.digits(value))


def verdict_text(result: Any) -> str:
    """Return whether the tests determine a result; of a parameter, what would."""
    return getattr(result, "verdict", "determined" if result.determined else "not determined")


def _is_assessed(result: Estimate | Quantity) -> bool:
    return field_of("method")(result) != NOT_ASSESSED


def _interval_text(result: Estimate | Quantity) -> str:
    return numbers.interval(result.interval) if _is_assessed(result) else ""


def _bootstrap_text(result: Estimate | Quantity) -> str:
    if isinstance(result, Estimate) and result.bootstrap and result.determined:
        return numbers.interval(result.bootstrap)
    return ""


def _sensitivity_text(result: Estimate | Quantity) -> str:
    if isinstance(result, Estimate) and _is_assessed(result):
        return f"{100 * result.sensitivity:.3g}"
    return ""


# Of parameters, and of quantities derived from them, which lack some of the fields.
ESTIMATE_COLUMNS = (
    field_column("name", ""),
    field_column("symbol", "parameter", lambda result: getattr(result, "symbol", result.name)),
    field_column("unit"),
    field_column("value", "value ± standard error", estimate_text),
    Column("standard_error", value=field_of("error")),
    *interval_columns("interval_95_{}", "95 %", field_of("interval"), _interval_text),
    field_column("method", ""),
    *interval_columns("bootstrap_95_{}", "bootstrap", field_of("bootstrap"), _bootstrap_text),
    Column("bound_lower", value=field_of("lower")),
    Column("bound_upper", value=field_of("upper")),
    Column("rmse_change_for_1_percent", "RMSE for ±1 % / %", field_of("sensitivity"), _sensitivity_text),
    field_column("determined", ""),
    field_column("verdict", text=verdict_text),
)


def parameter_table(direction: str, name: str, title: str, estimates: Estimates) -> RecordTable:
    """Return parameters, then quantities derived from them.

    On pages the value of one that is not determined is faint, and where no interval was computed there is
    only the value.
    """
    records = (*estimates.parameters, *estimates.derived)
    return RecordTable(f"{direction}-{name}", f"{direction}: {title}", ESTIMATE_COLUMNS, records)


QUANTITY_TITLES = {
    "dead_zone": "dead zone",
    "flow_begins": "command at which flow starts",
    "delay": "delay (5 %)",
    "response_time": "response time (63 %)",
}


def characteristic_table(direction: str, characteristics: Characteristics) -> RecordTable:
    """Return dead zone, command at which flow starts, delay and response time."""
    unit, level = characteristics.command_unit, characteristics.level
    columns = (
        Column("quantity", "quantity", field_of("name"), lambda quantity: QUANTITY_TITLES[quantity.name]),
        field_column("unit"),
        field_column("value", text=estimate_text),
        *interval_columns("interval_95_{}", "95 %", field_of("interval")),
        field_column("determined", "verdict", verdict_text),
        Column(f"step_to_{unit}", value=lambda quantity: level),
    )
    title = f"{direction}: dead zone, delay, response time (step to {numbers.digits(level)} {unit})"
    records = tuple(
        replace(quantity, name=name, unit=own_unit)
        for name, (quantity, own_unit) in characteristics.quantities.items()
    )
    return RecordTable(f"{direction}-characteristics", title, columns, records)


def speed_map_table(direction: str, characteristics: Characteristics, *, load_unit: str = "") -> RecordTable:
    """Return the speed map, in files with the measured speeds of the identification tests below it.

    The unit of the load is in the name of its column in files.
    """
    unit, speed_unit, load = characteristics.command_unit, characteristics.speed_unit, characteristics.load
    loads = (number_column(f"{load}_{load_unit}", load, field_of("load")),) if load else ()
    columns = (
        Column("origin", value=lambda point: "model" if hasattr(point, "interval") else "measured"),
        number_column(f"command_{unit}", f"command / {unit}", field_of("command")),
        *loads,
        Column(
            f"speed_{speed_unit}",
            f"speed / ({speed_unit})",
            field_of("speed"),
            lambda point: determined_text(point.speed, determined=point.determined),
        ),
        *interval_columns(f"interval_95_{{}}_{speed_unit}", "95 %", field_of("interval")),
        field_column("determined", "verdict", verdict_text),
    )
    title = f"{direction}: speed map, at mid stroke"
    points, measured = characteristics.speed_map, characteristics.measured
    return RecordTable(f"{direction}-speed-map", title, columns, points, measured)


def load_table(direction: str, load_scatter: LoadScatter) -> RecordTable:
    """Return the scatter of the speed between tests, then each test's own speed, relative to the model's."""

    def speed(result: LoadScatter | LoadOfTest) -> float:
        return result.scatter if isinstance(result, LoadScatter) else result.speed

    def speed_text(result: LoadScatter | LoadOfTest) -> str:
        text = f"{100 * speed(result):.2f}"
        return text if result.determined else Faint(text)

    def ends_text(result: LoadScatter | LoadOfTest) -> str:
        lower, upper = (None if end is None else 100 * end for end in result.interval)
        return numbers.interval((lower, upper))

    def verdict(result: LoadScatter | LoadOfTest) -> str:
        if isinstance(result, LoadScatter):
            return f"{verdict_text(result)}, shrinkage {100 * result.shrinkage:.0f} %"
        return "" if result.determined else verdict_text(result)

    columns = (
        Column(
            "test",
            "test",
            lambda result: getattr(result, "test", "scatter"),
            lambda result: getattr(result, "test", "scatter between tests"),
        ),
        Column("speed", "speed above the model's / %", speed, speed_text),
        *interval_columns("interval_95_{}", "95 %", field_of("interval"), ends_text),
        field_column("shrinkage", ""),
        # Whether a single test's value is determined stands on pages alone.
        Column("determined", value=lambda result: result.determined if result is load_scatter else None),
        Column(label="verdict", text=verdict),
    )
    title = f"{direction}: speed of each test above the model's, by a load that nobody measures"
    records = (load_scatter, *load_scatter.tests)
    return RecordTable(f"{direction}-load-scatter", title, columns, records)
