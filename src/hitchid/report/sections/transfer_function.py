"""The transfer function of a benchmark, written out with its values."""

from collections.abc import Sequence
from itertools import starmap

from hitchid.report.document import Equation, Text
from hitchid.structures import PhysicalModel

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS = "\N{MINUS SIGN}"
SPACE = '<mspace width="0.15em"/>'
LEFT_SIDE = '<mi>G</mi><mo stretchy="false">(</mo><mi>s</mi><mo stretchy="false">)</mo><mo>=</mo>'
AROUND = (
    "Nonlinearities of valve, stroke and load act before and after G(s); their parameters are in the table."
)


def transfer_function(benchmark: PhysicalModel, unit: str, command_unit: str) -> tuple[Text | Equation, ...]:
    """Return G(s) of a benchmark with its symbols and with its values; for a nonlinear one its formula.

    Args:
        benchmark: of one direction.
        unit, command_unit: of displacement and command.
    """
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
