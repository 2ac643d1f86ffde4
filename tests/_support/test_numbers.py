"""Numbers as text: as many digits as their error leaves them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support import numbers


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (41.847, 0.3, "41.85 ± 0.30"),
        (41.847, 0.0312, "41.847 ± 0.031"),
        (41.847, 3.12, "41.8 ± 3.1"),
        (-0.52341, 0.0123, "-0.523 ± 0.012"),
        (418.47, 31.2, "418.5 ± 31"),
        (0.00052341, 0.0000312, "0.0005234 ± 3.1e-05"),
        (41.847, None, "41.85"),
        (41.847, 0.0, "41.85"),
        (41.847, float("nan"), "41.85"),
        (0.0, 0.3, "0"),
    ],
)
def test_a_value_has_the_digits_that_its_error_leaves_it(value, error, text):
    assert numbers.with_error(value, error) == text


@given(value=st.floats(1e-2, 999.0), share=st.floats(1e-3, 1.0))
def test_a_stated_value_is_right_within_its_error(value, share):
    error = share * value
    shown, doubt = map(float, numbers.with_error(value, error).split(" ± "))
    # Two digits of the error: half a unit of the second is a twentieth of it at most; beyond 10 four digits
    # of the value are shown, half a unit of which is 1/2000 of it and the error then a hundredth at least.
    assert abs(shown - value) <= max(0.05 * error, 0.05) * (1 + 1e-9)
    assert abs(doubt - error) <= 0.05 * error * (1 + 1e-9)


@pytest.mark.parametrize(("value", "error"), [(123456.0, 11.0), (5.12345e-4, 1e-8)])
def test_a_value_far_above_its_error_keeps_its_digits(value, error):
    shown, _ = map(float, numbers.with_error(value, error).split(" ± "))
    assert abs(shown - value) <= error


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        ((1.23456, 7.0), "1.235 … 7"),
        ((1.23456, None), "> 1.23"),
        ((None, 1.23456), "< 1.23"),
        ((None, None), "any"),
        ((0.0, 2.0), "0 … 2"),
        ((-1.0, 0.0), "-1 … 0"),
    ],
)
def test_an_interval_leaves_out_ends_that_are_not_given(interval, text):
    assert numbers.interval(interval) == text
