"""Tables of parameters with their intervals, and of operating characteristics."""

from hitchid.model import Characteristics, Estimates, Interval, LoadOfTest, LoadScatter
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report import numbers
from hitchid.report.document import Faint, Table


def parameter_table(title: str, estimates: Estimates) -> Table:
    """Return parameters and derived quantities; the value of one that is not determined is faint.

    Where no interval was computed there is only the value."""
    rows = [
        (
            estimate.symbol,
            estimate.unit,
            numbers.estimate(estimate),
            numbers.interval(estimate.interval) if estimate.method != NOT_ASSESSED else "",
            numbers.interval(estimate.bootstrap) if estimate.bootstrap and estimate.determined else "",
            f"{100 * estimate.sensitivity:.3g}" if estimate.method != NOT_ASSESSED else "",
            estimate.verdict,
        )
        for estimate in estimates.parameters
    ]
    rows += [
        (
            quantity.name,
            quantity.unit,
            numbers.quantity(quantity),
            numbers.interval(quantity.interval),
            "",
            "",
            numbers.determined(quantity),
        )
        for quantity in estimates.derived
    ]
    header = (
        "parameter",
        "unit",
        "value ± standard error",
        "95 %",
        "bootstrap",
        "RMSE for ±1 % / %",
        "verdict",
    )
    return Table(title, header, tuple(rows))


def load_table(direction: str, load_scatter: LoadScatter) -> Table:
    """Return the scatter of the speed between tests, and each test's own speed."""

    def row(name: str, value: float, result: LoadScatter | LoadOfTest, verdict: str = "") -> tuple[str, ...]:
        percent = f"{100 * value:.2f}"
        interval = numbers.interval(_in_percent(result.interval))
        return name, percent if result.determined else Faint(percent), interval, verdict

    verdict = f"{numbers.determined(load_scatter)}, shrinkage {100 * load_scatter.shrinkage:.0f} %"
    rows = [row("scatter between tests", load_scatter.scatter, load_scatter, verdict)]
    rows += [
        row(test.test, test.speed, test, "" if test.determined else numbers.determined(test))
        for test in load_scatter.tests
    ]
    header = ("test", "speed above the model's / %", "95 %", "verdict")
    return Table(
        f"{direction}: speed of each test above the model's, by a load that nobody measures",
        header,
        tuple(rows),
    )


def _in_percent(interval: Interval) -> Interval:
    lower, upper = interval
    return None if lower is None else 100 * lower, None if upper is None else 100 * upper


def characteristic_tables(direction: str, characteristics: Characteristics) -> list[Table]:
    """Return the speed map of a direction, and its dead zone, delay and response time."""
    unit, load = characteristics.command_unit, characteristics.load
    rows = tuple(
        (
            numbers.digits(point.command),
            *([numbers.digits(point.load)] if load else []),
            numbers.quantity(point),
            numbers.interval(point.interval),
            numbers.determined(point),
        )
        for point in characteristics.speed_map
    )
    speed_header = f"speed / ({characteristics.speed_unit})"
    header = (f"command / {unit}", *([load] if load else []), speed_header, "95 %", "verdict")
    quantities = (
        ("dead zone", unit, characteristics.dead_zone),
        ("command at which flow starts", unit, characteristics.opening),
        ("delay (5 %)", "s", characteristics.delay),
        ("response time (63 %)", "s", characteristics.response_time),
    )
    quantity_rows = tuple(
        (
            name,
            quantity_unit,
            numbers.quantity(quantity),
            numbers.interval(quantity.interval),
            numbers.determined(quantity),
        )
        for name, quantity_unit, quantity in quantities
        if quantity is not None
    )
    step = f"step to {numbers.digits(characteristics.level)} {unit}"
    return [
        Table(f"{direction}: speed map, at mid stroke", header, rows),
        Table(
            f"{direction}: dead zone, delay, response time ({step})",
            ("quantity", "unit", "value", "95 %", "verdict"),
            quantity_rows,
        ),
    ]
