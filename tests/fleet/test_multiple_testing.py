"""Adjusted p-values against those of the paper and by hand."""

import numpy as np

from hitchid.fleet.random_effects import adjusted_p_values


def test_the_paper_s_example_has_four_discoveries():
    """Benjamini & Hochberg 1995, section 3.2: of 15 tests four are discoveries at a rate of 0.05."""
    small = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459]
    p_values = np.array([*small, 0.324, 0.4262, 0.5719, 0.6528, 0.759, 1.0])
    adjusted = adjusted_p_values(p_values[::-1])[::-1]
    assert np.flatnonzero(adjusted <= 0.05).tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(adjusted[[3, 14]], [15 * 0.0095 / 4, 1.0], rtol=1e-12)


def test_missing_tests_are_not_counted():
    """Of three tests: 3 · 0.01/1, 3 · 0.03/2, 3 · 0.5/3."""
    adjusted = adjusted_p_values(np.array([[0.01, np.nan], [0.5, 0.03]]))
    np.testing.assert_allclose(adjusted, [[0.03, np.nan], [0.5, 0.045]], rtol=1e-12)


def test_rates_rise_with_p_values():
    """Of two tests 2 · 0.04/1 = 0.08 lies above 2 · 0.05/2 = 0.05, at which both are discoveries."""
    np.testing.assert_allclose(adjusted_p_values(np.array([0.04, 0.05])), [0.05, 0.05], rtol=1e-12)


def test_without_tests_there_is_nothing_to_adjust():
    assert np.isnan(adjusted_p_values(np.full(3, np.nan))).all()
