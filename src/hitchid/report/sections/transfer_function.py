"""The transfer function of a benchmark, written out with its values."""

from collections.abc import Sequence

from hitchid.report.document import Equation, Text
from hitchid.structures import PhysicalModel
from hitchid.validation.report_data import DirectionData

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def transfer_function(data: DirectionData) -> tuple[Text | Equation, ...]:
    """Return G(s) of the benchmark with its symbols and with its values; for a nonlinear one its formula."""
    benchmark, unit, command_unit = data.channel.benchmark, data.unit, data.command_unit
    structure = benchmark.structure
    if structure.linear is None:
        return (Text(f"Benchmark: structure {structure.name}, {structure.formula}."),)
    around = (
        ""
        if benchmark.nonlinearity is None
        else " The nonlinearities of valve, stroke and load act before and after G(s); their parameters are in "
        "the table."
    )
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
    delay = f" · e^(−{_number(dead_time_s)} s)" if dead_time_s else ""
    text = f"G(s) = {_grouped(_polynomial(numerator))} / {_grouped(_polynomial(denominator))}{delay}"
    exponent = f"<mrow><mo>−</mo><mn>{_number(dead_time_s)}</mn><mi>s</mi></mrow>"
    mathml = (
        '<math display="block"><mi>G</mi><mo>(</mo><mi>s</mi><mo>)</mo><mo>=</mo>'
        f"<mfrac>{_polynomial_mathml(numerator)}{_polynomial_mathml(denominator)}</mfrac>"
        f"{f'<msup><mi>e</mi>{exponent}</msup>' if dead_time_s else ''}</math>"
    )
    return Equation(text, mathml)


def _terms(coefficients: Sequence[float]) -> list[tuple[str, int]]:
    """Return the terms that are not zero, highest power first: coefficient, empty for 1, and power of s."""
    powers = range(len(coefficients) - 1, -1, -1)
    return [
        ("" if coefficient == 1 and power else _number(coefficient), power)
        for coefficient, power in zip(coefficients, powers, strict=True)
        if coefficient
    ]


def _polynomial(coefficients: Sequence[float]) -> str:
    def power_text(power: int) -> str:
        return "" if not power else "s" if power == 1 else f"s{str(power).translate(SUPERSCRIPTS)}"

    return " + ".join(" ".join(filter(None, (c, power_text(power)))) for c, power in _terms(coefficients))


def _polynomial_mathml(coefficients: Sequence[float]) -> str:
    def power_mathml(power: int) -> str:
        symbol = "<mi>s</mi>"
        return "" if not power else symbol if power == 1 else f"<msup>{symbol}<mn>{power}</mn></msup>"

    terms = (
        f"<mn>{c}</mn>{power_mathml(power)}" if c else power_mathml(power)
        for c, power in _terms(coefficients)
    )
    return f"<mrow>{'<mo>+</mo>'.join(terms)}</mrow>"


def _grouped(polynomial: str) -> str:
    return f"({polynomial})" if " " in polynomial else polynomial


def _number(value: float) -> str:
    """Return four significant digits, powers of ten as in 1.2·10⁻⁵."""
    mantissa, _, exponent = f"{value:.4g}".partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPTS)}" if exponent else mantissa
