"""Parameters of one direction with their intervals, operating characteristics, valve, dead zone."""

from collections.abc import Sequence
from itertools import starmap

from hitchid._support import numbers
from hitchid.model import Characteristics, Interval, Quantity
from hitchid.model.estimates import NOT_ASSESSED
from hitchid.report import figures
from hitchid.report.context import DirectionContext
from hitchid.report.document import Block, Equation, Pictures, ReportSection, Text, sentence
from hitchid.structures import PhysicalModel
from hitchid.validation.estimate_tables import (
    characteristic_table,
    load_table,
    parameter_table,
    speed_map_table,
)

# The transfer function of a benchmark, written out with its values.

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS = "\N{MINUS SIGN}"
SPACE = '<mspace width="0.15em"/>'
LEFT_SIDE = '<mi>G</mi><mo stretchy="false">(</mo><mi>s</mi><mo stretchy="false">)</mo><mo>=</mo>'
AROUND = (
    "Nonlinearities of valve, stroke and load act before and after G(s); their parameters are in the table."
)


def transfer_function(benchmark: PhysicalModel, unit: str, command_unit: str) -> tuple[Text | Equation, ...]:
    """Return G(s) of a benchmark with its symbols and with its values; for a nonlinear one its formula."""
    structure = benchmark.structure
    if structure.linear is None:
        return (Text(f"Benchmark: structure {structure.name}, {structure.formula}."),)
    around = "" if benchmark.nonlinearity is None else f" {AROUND}"
    introduction = (
        f"Benchmark: structure {structure.name}, G(s) = {structure.formula}, from the command above the dead "
        f"zone, in {command_unit}, to the displacement from its start, in {unit}; s in 1/s.{around}"
    )
    return Text(introduction), equation(benchmark)


def equation(benchmark: PhysicalModel) -> Equation:
    """Return G(s) of a linear benchmark, its dead time T included: B(s)/A(s) · e^(−T s)."""
    values = tuple(map(float, benchmark.values))
    numerator, denominator = benchmark.structure.require_linear().transfer_function(values)
    dead_time_s = float(benchmark.dead_time_s)
    delay = f" · e^({MINUS}{_number(dead_time_s)} s)" if dead_time_s else ""
    text = f"G(s) = {_grouped(_polynomial(numerator))} / {_grouped(_polynomial(denominator))}{delay}"
    exponent = f"<mrow><mo>{MINUS}</mo><mn>{_number(dead_time_s)}</mn>{SPACE}<mi>s</mi></mrow>"
    factor = f"<msup><mi>e</mi>{exponent}</msup>" if dead_time_s else ""
    fraction = f"<mfrac>{_polynomial_mathml(numerator)}{_polynomial_mathml(denominator)}</mfrac>"
    return Equation(text, f'<math display="block">{LEFT_SIDE}{fraction}{factor}</math>')


def _terms(coefficients: Sequence[float]) -> list[tuple[str, int]]:
    """Return the terms that are not zero, highest power first: coefficient, empty for 1, and power of s."""
    powers = range(len(coefficients) - 1, -1, -1)
    return [
        ("" if coefficient == 1 and power else _number(coefficient), power)
        for coefficient, power in zip(coefficients, powers, strict=True)
        if coefficient
    ]


def _polynomial(coefficients: Sequence[float]) -> str:
    def term(coefficient: str, power: int) -> str:
        symbol = ("", "s")[power] if power < 2 else f"s{str(power).translate(SUPERSCRIPTS)}"
        return f"{coefficient} {symbol}".strip()

    return " + ".join(starmap(term, _terms(coefficients))).replace("+ -", f"{MINUS} ")


def _polynomial_mathml(coefficients: Sequence[float]) -> str:
    def term(coefficient: str, power: int) -> str:
        factor = f"<mn>{coefficient}</mn>{SPACE if power else ''}" if coefficient else ""
        symbol = ("", "<mi>s</mi>")[power] if power < 2 else f"<msup><mi>s</mi><mn>{power}</mn></msup>"
        return factor + symbol

    plus, minus = "<mo>+</mo>", f"<mo>{MINUS}</mo>"
    polynomial = plus.join(starmap(term, _terms(coefficients)))
    return f"<mrow>{polynomial.replace(f'{plus}<mn>-', f'{minus}<mn>')}</mrow>"


def _grouped(polynomial: str) -> str:
    return f"({polynomial})" if " " in polynomial else polynomial


def _number(value: float) -> str:
    """Return four significant digits, powers of ten as in 1.2·10⁻⁵."""
    mantissa, _, exponent = f"{value:.4g}".partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPTS)}" if exponent else mantissa


# Operating characteristics as sentences.

VERBS = {"lifting": "lifts", "lowering": "lowers"}


def characteristic_sentences(characteristics: Characteristics, direction: str) -> tuple[str, ...]:
    """Return dead zone, speeds and times of one direction, one sentence each, at the middle load."""
    unit, opening = characteristics.command_unit, characteristics.opening
    sentences = [
        f"flow begins at {_quantity_text(opening, unit)}"
        if opening
        else f"dead zone {_quantity_text(characteristics.dead_zone, unit)}"
    ]
    loads = sorted({point.load for point in characteristics.speed_map if point.load is not None})
    middle = loads[len(loads) // 2] if loads else None
    speeds = [
        _value_text(point.speed, characteristics.speed_unit, point.interval, determined=point.determined)
        + f" at {point.command:.3g} {unit}"
        for point in characteristics.speed_map
        if point.load == middle
    ]
    load_phrase = f", with {characteristics.load} {middle:.4g}" if middle is not None else ""
    sentences.append(f"the piston {VERBS[direction]} at mid stroke{load_phrase}: {'; '.join(speeds)}")
    if characteristics.delay is not None and characteristics.response_time is not None:
        sentences.append(
            f"after a step to {characteristics.level:.3g} {unit} motion starts (5 % of the speed) after "
            f"{_quantity_text(characteristics.delay, 's')} and reaches 63 % of its speed after "
            f"{_quantity_text(characteristics.response_time, 's')}"
        )
    return tuple(sentences)


def _quantity_text(quantity: Quantity, unit: str) -> str:
    return _value_text(quantity.value, unit, quantity.interval, determined=quantity.determined)


def _value_text(value: float, unit: str, interval: Interval, *, determined: bool) -> str:
    if interval == (value, value):
        return f"{value:.3g} {unit}"
    caveat = "" if determined else ", not determined"
    return f"{value:.3g} {unit} ({numbers.interval(interval)}{caveat})"


def parameters_section(context: DirectionContext) -> ReportSection:
    """Return the section on parameters with their intervals, the valve, and the dead zone."""
    result, data, direction, trace = context.result, context.data, context.direction, context.trace
    units = (data.unit, data.command_unit)
    blocks: list[Block] = [*transfer_function(data.channel.benchmark, *units)]
    pictures = [figures.valve_map(context.figure_name("valve"), data.valve_map, *units)]
    for estimates, model, name in (
        (result.parameters, "benchmark", "intervals"),
        (result.paper_parameters, "paper's transfer function", "paper-intervals"),
    ):
        if estimates is not None and estimates.parameters:
            title = f"parameters of the {model}"
            blocks.append(parameter_table(direction, name, title, estimates).shown())
            assessed = [estimate for estimate in estimates.parameters if estimate.method != NOT_ASSESSED]
            if assessed:
                pictures.append(figures.intervals(context.figure_name(name), title, assessed))
    if result.characteristics is not None:
        sentences = map(sentence, characteristic_sentences(result.characteristics, direction))
        blocks += [
            Text(" ".join(sentences)),
            speed_map_table(direction, result.characteristics).shown(),
            characteristic_table(direction, result.characteristics).shown(),
        ]
    if result.load_scatter is not None:
        blocks.append(load_table(direction, result.load_scatter).shown())
        pictures.append(figures.loads(context.figure_name("loads"), result.load_scatter))
    if data.ramps and trace is not None and trace.dead_zone.value > 0:
        name = context.figure_name("dead-zone")
        pictures.append(figures.dead_zone(name, data.ramps, direction, trace.dead_zone, *units))
    return ReportSection("Parameters", (*blocks, Pictures(tuple(pictures))))
