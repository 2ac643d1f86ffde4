"""Adjusted p-values against those of scipy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import false_discovery_control

from hitchid.fleet.multiple_testing import adjusted_p_values


@given(arrays(float, st.integers(1, 50), elements=st.floats(0, 1)))
def test_they_are_those_of_benjamini_and_hochberg(p_values):
    np.testing.assert_allclose(adjusted_p_values(p_values), false_discovery_control(p_values), rtol=1e-12)


def test_missing_tests_are_not_counted():
    p_values = np.array([[0.01, np.nan], [0.5, 0.03]])
    expected = false_discovery_control([0.01, 0.5, 0.03])
    np.testing.assert_allclose(
        adjusted_p_values(p_values), [[expected[0], np.nan], [expected[1], expected[2]]], rtol=1e-12
    )


def test_without_tests_there_is_nothing_to_adjust():
    assert np.isnan(adjusted_p_values(np.full(3, np.nan))).all()
