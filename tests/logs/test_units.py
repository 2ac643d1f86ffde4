"""Units: conversions against their definitions, and what holds for every pair."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.logs.units import (
    NOT_COLUMN_SUFFIXES,
    SPELLINGS,
    UNITS,
    check_unit,
    conversion_factor,
    parse_unit,
    unit_of_column,
)

EPS = np.finfo(np.float64).eps
POUND_KG, GRAVITY_M_S2, INCH_M = 0.45359237, 9.80665, 0.0254

units = st.sampled_from(sorted(UNITS))


@st.composite
def same_dimension(draw, count):
    first = draw(units)
    like = [name for name, unit in UNITS.items() if unit.dimension == UNITS[first].dimension]
    return (first, *(draw(st.sampled_from(like)) for _ in range(count - 1)))


@pytest.mark.parametrize(
    ("unit", "target", "factor"),
    [
        ("in", "mm", 25.4),
        ("cm", "mm", 10.0),
        ("m", "cm", 100.0),
        ("mA", "A", 1 / 1000),
        ("percent", "1", 1 / 100),
        ("deg", "rad", math.pi / 180),
        ("bar", "Pa", 1e5),
        ("MPa", "bar", 10.0),
        ("psi", "Pa", POUND_KG * GRAVITY_M_S2 / INCH_M**2),
        ("s", "ms", 1000.0),
    ],
)
def test_a_conversion_is_what_the_unit_is_defined_to_be(unit, target, factor):
    # Each side is a few rounded products.
    assert conversion_factor(unit, target, "x") == pytest.approx(factor, rel=8 * EPS)


@given(same_dimension(3))
def test_a_detour_through_a_third_unit_changes_nothing(three):
    a, b, c = three
    detour = conversion_factor(a, b, "x") * conversion_factor(b, c, "x")
    assert detour == pytest.approx(conversion_factor(a, c, "x"), rel=4 * EPS)
    # Two rounded quotients and their rounded product: three halves of an eps.
    assert abs(conversion_factor(a, b, "x") * conversion_factor(b, a, "x") - 1) <= 2 * EPS


@given(units)
def test_a_unit_is_exactly_once_itself(unit):
    assert conversion_factor(unit, unit, "x") == 1.0
    assert check_unit(unit, "x") == unit


@given(units, units)
def test_units_of_two_dimensions_do_not_convert(unit, target):
    if UNITS[unit].dimension == UNITS[target].dimension:
        assert conversion_factor(unit, target, "x") > 0
        return
    with pytest.raises(InputError) as caught:
        conversion_factor(unit, target, "log.csv: time")
    for said in ("log.csv: time", f"'{unit}'", f"'{target}'", UNITS[unit].dimension, UNITS[target].dimension):
        assert said in str(caught.value)


@pytest.mark.parametrize("pair", [("furlong", "mm"), ("mm", "furlong"), ("MM", "mm"), ("", "mm")])
def test_an_unknown_unit_is_named_beside_all_that_are_known(pair):
    with pytest.raises(InputError) as caught:
        conversion_factor(*pair, "campaign.toml")
    message = str(caught.value)
    assert message.startswith("campaign.toml: ")
    assert all(unit in message for unit in UNITS)
    assert any(f"'{unit}'" in message for unit in pair if unit not in UNITS)


@given(st.text(min_size=1), units.filter(lambda unit: unit not in NOT_COLUMN_SUFFIXES))
def test_a_column_name_says_its_unit_after_its_last_underscore(stem, unit):
    assert unit_of_column(f"{stem}_{unit}") == unit


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("STROKE_MM", "mm"),
        ("Stroke_IN", "in"),
        ("P_BAR", "bar"),
        ("valve_pct", "percent"),
        # Cylinder 1 and the lowest value are no units, nor is a part that stands alone or inside.
        *((f"stroke_{suffix}", None) for suffix in NOT_COLUMN_SUFFIXES),
        *(
            (name, None)
            for name in ("mm", "stroke", "stroke_", "valve_a", "side_v", "stroke_mm_", "strokemm")
        ),
        ("", None),
    ],
)
def test_a_column_name_may_say_its_unit_in_any_case(column, unit):
    assert unit_of_column(column) == unit


IN_ANY_CASE = {
    "in": ("IN", '"', "in.", "Inch"),
    "mm": ("MM", "Mm"),
    "um": ("\u00b5m", "\u03bcM"),
    "mA": ("MA", "ma"),
    "bar": ("BAR",),
    "kPa": ("KPA",),
    "deg": ("DEG", "\u00b0"),
    "s": ("SEC", "S"),
    "percent": ("(%)", "PERCENT"),
    None: ("", "kNm", "degF", "l/h", "furlong", "M M"),
}


@pytest.mark.parametrize(
    ("spelling", "unit"), [(spelling, unit) for unit, texts in IN_ANY_CASE.items() for spelling in texts]
)
def test_known_units_are_known_in_any_case_and_no_others(spelling, unit):
    assert parse_unit(spelling) == unit


@given(units)
def test_a_unit_is_known_by_itself_and_in_brackets(unit):
    assert parse_unit(unit) == parse_unit(f" [{unit}] ") == unit


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_every_spelling_means_a_unit_there_is(spelling):
    assert parse_unit(spelling.title()) == parse_unit(spelling) == SPELLINGS[spelling]
    assert SPELLINGS[spelling] in UNITS
