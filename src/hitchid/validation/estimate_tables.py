"""Tables of parameters with their intervals, of operating characteristics, and of loads of tests."""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

from hitchid._support import numbers
from hitchid._support.tables import Column, Faint, RecordTable, interval_columns, number_column
from hitchid.model import Characteristics, Estimate, Estimates, LoadScatter, Quantity
from hitchid.model.estimates import NOT_ASSESSED


def estimate_text(result: Estimate | Quantity) -> str:
    """Return a value with its standard error; only the value, faint, if it is not determined."""
    if result.determined and _field("method")(result) != NOT_ASSESSED:
        return numbers.with_error(result.value, _field("error")(result))
    return determined_text(result.value, determined=result.determined)


def determined_text(value: float, *, determined: bool) -> str:
    """Return a value with four digits, faint if the tests do not determine it."""
    return numbers.digits(value) if determined else Faint(numbers.digits(value))


def verdict_text(result: Any) -> str:
    """Return whether the tests determine a result; of a parameter, what would."""
    return getattr(result, "verdict", "determined" if result.determined else "not determined")


def _field(name: str) -> Callable[[Any], Any]:
    """Return a function for a field of an estimate, None of a derived quantity, which has fewer."""
    return lambda record: getattr(record, name, None)


def _if_assessed(text: Callable[[Any], str]) -> Callable[[Any], str]:
    return lambda record: "" if _field("method")(record) == NOT_ASSESSED else text(record)


ESTIMATE_COLUMNS = (
    Column("name", value=_field("name")),
    Column("symbol", "parameter", _field("symbol"), lambda result: getattr(result, "symbol", result.name)),
    Column("unit", "unit", _field("unit")),
    Column("value", "value ± standard error", _field("value"), estimate_text),
    Column("standard_error", value=_field("error")),
    *interval_columns(
        "interval_95_{}",
        "95 %",
        _field("interval"),
        _if_assessed(lambda result: numbers.interval(result.interval)),
    ),
    Column("method", value=_field("method")),
    *interval_columns(
        "bootstrap_95_{}",
        "bootstrap",
        _field("bootstrap"),
        lambda result: (
            numbers.interval(result.bootstrap) if _field("bootstrap")(result) and result.determined else ""
        ),
    ),
    Column("bound_lower", value=_field("lower")),
    Column("bound_upper", value=_field("upper")),
    Column(
        "rmse_change_for_1_percent",
        "RMSE for ±1 % / %",
        _field("sensitivity"),
        _if_assessed(
            lambda result: f"{100 * result.sensitivity:.3g}" if hasattr(result, "sensitivity") else ""
        ),
    ),
    Column("determined", value=_field("determined")),
    Column("verdict", "verdict", _field("verdict"), verdict_text),
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
        Column("quantity", "quantity", itemgetter(0), lambda record: QUANTITY_TITLES[record[0]]),
        Column("unit", "unit", itemgetter(2)),
        Column("value", "value", lambda record: record[1].value, lambda record: estimate_text(record[1])),
        *interval_columns("interval_95_{}", "95 %", lambda record: record[1].interval),
        Column(
            "determined",
            "verdict",
            lambda record: record[1].determined,
            lambda record: verdict_text(record[1]),
        ),
        Column(f"step_to_{unit}", value=lambda record: level),
    )
    title = f"{direction}: dead zone, delay, response time (step to {numbers.digits(level)} {unit})"
    records = tuple((name, *quantity) for name, quantity in characteristics.quantities.items())
    return RecordTable(f"{direction}-characteristics", title, columns, records)


def speed_map_table(direction: str, characteristics: Characteristics, *, load_unit: str = "") -> RecordTable:
    """Return the speed map, in files with the measured speeds of the identification tests below it.

    The unit of the load is in the name of its column in files.
    """
    unit, speed_unit, load = characteristics.command_unit, characteristics.speed_unit, characteristics.load
    loads = (number_column(f"{load}_{load_unit}", load, _field("load")),) if load else ()
    columns = (
        Column("origin", value=lambda point: "model" if hasattr(point, "interval") else "measured"),
        number_column(f"command_{unit}", f"command / {unit}", _field("command")),
        *loads,
        Column(
            f"speed_{speed_unit}",
            f"speed / ({speed_unit})",
            _field("speed"),
            lambda point: determined_text(point.speed, determined=point.determined),
        ),
        *interval_columns(f"interval_95_{{}}_{speed_unit}", "95 %", _field("interval")),
        Column("determined", "verdict", _field("determined"), verdict_text),
    )
    title = f"{direction}: speed map, at mid stroke"
    points, measured = characteristics.speed_map, characteristics.measured
    return RecordTable(f"{direction}-speed-map", title, columns, points, measured)


def load_table(direction: str, load_scatter: LoadScatter) -> RecordTable:
    """Return the scatter of the speed between tests, then each test's own speed, relative to the model's."""

    def percent(record: tuple) -> str:
        text = f"{100 * record[2]:.2f}"
        return text if record[3].determined else Faint(text)

    def ends(record: tuple) -> str:
        lower, upper = (None if end is None else 100 * end for end in record[3].interval)
        return numbers.interval((lower, upper))

    def verdict(record: tuple) -> str:
        if record[3] is load_scatter:
            return f"{verdict_text(load_scatter)}, shrinkage {100 * load_scatter.shrinkage:.0f} %"
        return "" if record[3].determined else verdict_text(record[3])

    columns = (
        Column("test", "test", itemgetter(0), itemgetter(1)),
        Column("speed", "speed above the model's / %", itemgetter(2), percent),
        *interval_columns("interval_95_{}", "95 %", lambda record: record[3].interval, ends),
        Column("shrinkage", value=lambda record: getattr(record[3], "shrinkage", None)),
        Column(
            "determined",
            "verdict",
            lambda record: load_scatter.determined if record[3] is load_scatter else None,
            verdict,
        ),
    )
    title = f"{direction}: speed of each test above the model's, by a load that nobody measures"
    records = (
        ("scatter", "scatter between tests", load_scatter.scatter, load_scatter),
        *((test.test, test.test, test.speed, test) for test in load_scatter.tests),
    )
    return RecordTable(f"{direction}-load-scatter", title, columns, records)
