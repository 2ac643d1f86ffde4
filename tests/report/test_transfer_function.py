"""G(s) written out: the number in the text is the transfer function, and the MathML says the same."""

import math
import re
from xml.etree import ElementTree

import jax.numpy as jnp
import numpy as np
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
def test_text_and_mathml_are_the_transfer_function(structure, dead_time_s):
    benchmark = physical_model(structure, 30.0, *handmade.VALUES[structure], dead_time_s=dead_time_s)
    written = equation(benchmark)
    numerator, denominator = benchmark.structure.transfer_function(tuple(map(float, benchmark.values)))
    for s in (0.3, 2.0, 40.0):
        expected = np.polyval(numerator, s) / np.polyval(denominator, s) * math.exp(-dead_time_s * s)
        # Each of at most five numbers has four digits.
        assert value_at(written.text, s) == pytest.approx(expected, rel=5 * 5e-4)
    root = ElementTree.fromstring(written.mathml)  # noqa: S314 - our own
    assert root.tag == "math"
    assert len(root.find("mfrac")) == 2
    numbers = [element.text for element in root.iter("mn") if element.text not in ("2", "3")]
    assert all(number in written.text for number in numbers)
    assert ("0.03" in numbers) == bool(dead_time_s)
    document = Document("A", sections=(ReportSection("B", (written,)),))
    assert written.mathml in render(document, "html").decode()
    assert written.text in render(document, "markdown").decode()


def test_small_coefficients_are_powers_of_ten_ones_are_left_out():
    written = equation(physical_model("integrator-second-order", 25.0, 500.0, 0.5))
    assert written.text == "G(s) = 25 / (4·10⁻⁶ s³ + 0.002 s² + s)"
    assert equation(physical_model("integrator", 1.0)).text == "G(s) = 1 / s"


def test_the_section_names_structure_units_and_nonlinearities():
    plain, around = physical_model("integrator", 30.0), handmade.channel(LIFTING, "integrator", shape=True)
    introduction, written = transfer_function(plain, "mm", "A")
    assert isinstance(written, Equation)
    assert "G(s) = K / s" in introduction.text
    assert "in A" in introduction.text
    assert "in mm" in introduction.text
    assert "onlinearities" not in introduction.text
    introduction, _ = transfer_function(around.benchmark, "mm", "A")
    assert "Nonlinearities of valve, stroke and load" in introduction.text


def test_a_nonlinear_structure_has_its_formula_alone():
    tanks = structure_named("cascaded-tanks")
    model = PhysicalModel(tanks, jnp.ones(len(tanks.parameters)), jnp.asarray(0.0))
    (written,) = transfer_function(model, "mm", "A")
    assert isinstance(written, Text)
    assert tanks.formula in written.text
