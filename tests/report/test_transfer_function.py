"""G(s) written out: the number in the text is the transfer function, and the MathML says the same."""

import math
import re
from xml.etree import ElementTree

import jax.numpy as jnp
import pytest

import handmade
from hitchid.logs.record import LIFTING
from hitchid.report import Document, ReportSection, render
from hitchid.report.document import Equation, Text
from hitchid.report.parameters_section import equation, transfer_function
from hitchid.structures import PhysicalModel, structure_named

STRUCTURES = ("integrator", "integrator-first-order", "first-order-lag", "integrator-second-order")
POWERS = {"²": "**2", "³": "**3"}
DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def physical_model(name, *values, dead_time_s=0.0):
    return PhysicalModel(structure_named(name), jnp.array(values), jnp.asarray(dead_time_s))


def value_at(text, s):
    """Return the value of the right side of an equation at s, by Python's arithmetic."""
    right = text.removeprefix("G(s) = ").replace("\N{MINUS SIGN}", "-")
    right = re.sub(r"·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda found: f"e{found[1].translate(DIGITS)}", right)
    for sign, power in POWERS.items():
        right = right.replace(sign, power)
    right = re.sub(r"(\d) s", r"\1*s", right).replace("·", "*").replace("e^(", "exp(")
    return eval(right, {"__builtins__": {}}, {"s": s, "exp": math.exp})  # noqa: S307 - our own text


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("dead_time_s", [0.0, 0.03])
def test_the_text_is_the_transfer_function(structure, dead_time_s):
    benchmark = physical_model(structure, 30.0, *handmade.VALUES[structure], dead_time_s=dead_time_s)
    numerator, denominator = benchmark.structure.transfer_function(tuple(map(float, benchmark.values)))
    for s in (0.3, 2.0, 40.0):
        rational = [
            sum(c * s**power for power, c in enumerate(reversed(p))) for p in (numerator, denominator)
        ]
        expected = rational[0] / rational[1] * math.exp(-dead_time_s * s)
        # Each of at most five numbers has four digits.
        assert value_at(equation(benchmark).text, s) == pytest.approx(expected, rel=5 * 5e-4)


def test_small_coefficients_are_powers_of_ten_and_ones_are_left_out():
    told = equation(physical_model("integrator-second-order", 25.0, 500.0, 0.5))
    assert told.text == "G(s) = 25 / (4·10⁻⁶ s³ + 0.002 s² + s)"
    assert equation(physical_model("integrator", 1.0)).text == "G(s) = 1 / s"


@pytest.mark.parametrize("structure", STRUCTURES)
def test_the_mathml_is_well_formed_and_says_what_the_text_says(structure):
    told = equation(physical_model(structure, 30.0, *handmade.VALUES[structure], dead_time_s=0.03))
    root = ElementTree.fromstring(told.mathml)  # noqa: S314 - our own
    assert root.tag == "math"
    fraction = root.find("mfrac")
    assert len(fraction) == 2
    numbers = [each.text for each in root.iter("mn") if each.text not in ("2", "3")]
    assert all(number in told.text for number in numbers)
    assert "0.03" in numbers


def test_the_section_names_structure_units_and_what_is_around_the_transfer_function():
    plain, around = physical_model("integrator", 30.0), handmade.channel(LIFTING, "integrator", shape=True)
    introduction, told = transfer_function(plain, "mm", "A")
    assert isinstance(told, Equation)
    assert "G(s) = K / s" in introduction.text
    assert "in A" in introduction.text
    assert "in mm" in introduction.text
    assert "onlinearities" not in introduction.text
    introduction, _ = transfer_function(around.benchmark, "mm", "A")
    assert "Nonlinearities of valve, stroke and load" in introduction.text


def test_a_nonlinear_structure_has_its_formula_alone():
    tanks = structure_named("cascaded-tanks")
    model = PhysicalModel(tanks, jnp.ones(len(tanks.parameters)), jnp.asarray(0.0))
    (told,) = transfer_function(model, "mm", "A")
    assert isinstance(told, Text)
    assert tanks.formula in told.text


def test_an_equation_is_mathml_on_the_page_and_text_elsewhere():
    told = equation(physical_model("integrator", 30.0))
    document = Document("A", sections=(ReportSection("B", (told,)),))
    assert told.mathml in render(document, "html").decode()
    assert told.text in render(document, "markdown").decode()
