"""Error figures: closed forms, and what holds for all predictions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from scipy.signal import lfilter

from hitchid._support.metrics import (
    SIGNIFICANCE,
    better_on_held_out_tests,
    better_p_value,
    error_figures,
    holm,
    independent_observations,
    log_ratio_p_value,
    rmse_error,
)

EPS = np.finfo(np.float64).eps

# Whole numbers, so that differences are exact and only means and roots round.
whole = st.integers(-100, 100).map(float)


@st.composite
def measured_tests(draw):
    """Draw one to four tests of 2 to 20 samples, at least one of which moves."""
    tests = draw(
        st.lists(
            st.integers(2, 20).flatmap(lambda n: arrays(np.float64, n, elements=whole)),
            min_size=1,
            max_size=4,
        )
    )
    tests[0][:2] = 0.0, 1.0
    return tests


@st.composite
def measured_and_predicted(draw):
    actual = draw(measured_tests())
    return actual, [draw(arrays(np.float64, a.size, elements=whole)) for a in actual]


@given(measured_and_predicted())
def test_figures_are_those_of_their_definitions(pair):
    figures, actual = error_figures(*pair), [rows.tolist() for rows in pair[0]]
    errors = (np.concatenate(pair[1]) - np.concatenate(pair[0])).tolist()
    squares = math.fsum(error**2 for error in errors)
    spread = math.fsum((sample - math.fsum(rows) / len(rows)) ** 2 for rows in actual for sample in rows)
    assert figures.rmse == pytest.approx(math.sqrt(squares / len(errors)), rel=1e-12)
    assert figures.mae == pytest.approx(math.fsum(map(abs, errors)) / len(errors), rel=1e-12)
    assert figures.r2 == pytest.approx(1 - squares / spread, rel=1e-12, abs=1e-12)
    assert figures.fit == pytest.approx(100 * (1 - math.sqrt(squares / spread)), rel=1e-12, abs=1e-10)
    assert figures.max_abs == max(map(abs, errors))
    assert figures.within_1 == pytest.approx(sum(abs(error) < 1 for error in errors) / len(errors))


def test_the_figures_of_a_hand_worked_example_come_out():
    # Errors 0, 3, −4, 0 about measurements 0, 0, 10, 10 (mean 5, spread 100): 25 is lost.
    figures = error_figures([np.array([0.0, 0.0, 10.0, 10.0])], [np.array([0.0, 3.0, 6.0, 10.0])])
    assert figures == (2.5, 1.75, 0.75, 50.0, 4.0, 0.5)


@pytest.mark.parametrize(("level", "samples"), [(0.0, 3), (0.1, 7), (-3.0, 100), (1e6 / 3, 7), (7e-3, 100)])
def test_where_nothing_moved_r2_and_fit_are_zero(level, samples):
    actual = np.full(samples, level)
    figures = error_figures([actual], [actual + 2.0])
    assert figures.rmse == pytest.approx(2.0, rel=1e-9)  # level + 2 − level rounds at 3e5 to 6e-11
    assert (figures.r2, figures.fit) == (0.0, 0.0)


def test_tests_and_predictions_must_be_as_many():
    with pytest.raises(ValueError, match=r"shorter"):
        error_figures([np.zeros(3), np.zeros(3)], [np.zeros(3)])
    with pytest.raises(ValueError, match="shape"):
        error_figures([np.zeros(3)], [np.zeros(2)])


@pytest.mark.parametrize(
    ("errors", "better"),
    [
        ([0.9, 0.9, 0.9], True),
        # Mean 0.146 and standard error 0.049 of the logarithms of six tests: t = 2.96 above t₅(90 %) = 1.48.
        ([0.8, 0.8, 0.8, 0.8, 1.01, 1.01], True),
        # Mean 0.107, standard error 0.052: t = 2.05.
        ([0.8, 0.8, 0.8, 1.01, 1.01, 1.01], True),
        # Mean 0.133, standard error 0.091 of three tests: t = 1.46 below t₂(90 %) = 1.89.
        ([0.8, 0.8, 1.05], False),
        # One test decides nothing, however much better it is there.
        ([0.1, 1.001, 1.001], False),
        ([0.01, 0.999, 0.999, 0.999, 0.999, 1.001, 1.001], False),
        ([0.5], False),
        # Without a test nothing is better.
        ([], False),
        # Better on all tests, but by less than 2 % in all.
        ([0.985, 0.985, 0.985], False),
        ([0.975, 0.975, 0.975], True),
        # Better on two of three, but not in all.
        ([0.9, 0.9, 1.3], False),
        ([1.0, 1.0, 1.0], False),
    ],
)
def test_a_model_is_better_by_two_percent_and_significantly(errors, better):
    assert better_on_held_out_tests(np.array(errors), np.ones(len(errors))) is better


def test_more_comparisons_ask_for_a_smaller_p_value():
    errors, ones = np.array([0.8, 0.8, 0.8, 1.01, 1.01, 1.01]), np.ones(6)
    # Mean (ln 1.25 − ln 1.01)/2 = 0.1066, standard error (ln 1.25 + ln 1.01)/2/√5 = 0.0521: t = 2.05, of
    # which Student's t with 5 degrees of freedom is exceeded with probability 0.048.
    assert log_ratio_p_value(errors, ones) == pytest.approx(0.048, abs=5e-4)
    assert better_on_held_out_tests(errors, ones, comparisons=1)
    assert not better_on_held_out_tests(errors, ones, comparisons=3)


@given(errors=st.lists(st.floats(0.01, 10.0), min_size=2, max_size=9), seed=st.integers(0, 99))
def test_of_a_typical_test_the_p_value_is_students(errors, seed):
    one = np.array(errors)
    other = one * np.random.default_rng(seed).uniform(0.5, 1.5, one.size)
    expected = stats.ttest_1samp(np.log(other / one), 0.0, alternative="greater").pvalue
    assert log_ratio_p_value(one, other) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([3.0, 3.0, 3.0], 0.0),
        # Tests of equal length: without either the RMSE is 7 or 1, its mean 4, and s² = 1/2 (3² + 3²) = 9.
        ([1.0, 7.0], 3.0),
        # One test says nothing of the next.
        ([1.0], np.nan),
    ],
)
def test_the_standard_error_of_hand_worked_examples_comes_out(errors, expected):
    estimate = rmse_error([np.zeros(5)] * len(errors), [np.full(5, error) for error in errors])
    assert estimate == pytest.approx(expected, rel=10 * EPS, abs=0, nan_ok=True)


def test_the_standard_error_is_what_campaigns_drawn_anew_show():
    """For tests of independent errors; 2000 campaigns tell a spread to 1/√4000 = 1.6 %, held to 5 of it."""
    rng = np.random.default_rng(0)
    draws = [[rng.standard_normal(20) for _ in range(16)] for _ in range(2000)]
    zeros = [np.zeros(20)] * 16
    figures = [np.sqrt(np.mean(np.square(draw))) for draw in draws]
    estimate = np.sqrt(np.mean([rmse_error(zeros, draw) ** 2 for draw in draws]))
    assert estimate == pytest.approx(np.std(figures), rel=0.08)


@pytest.mark.parametrize("tests", [3, 5, 20])
def test_of_models_alike_neither_surely_errs_less_but_by_chance(tests):
    """Per-test errors differ by 30 %: either is called better in 5 % of campaigns, and the jackknife is near.

    Of 500 campaigns 5 % are 25 ± 5; held to 9 %, for the root of few squares is skewed.
    """
    rng = np.random.default_rng(tests)
    samples = np.full(tests, 1000)
    called = 0
    for _ in range(500):
        one, other = np.exp(0.3 * rng.standard_normal((2, tests)))
        p_values = better_p_value(one, other, samples), better_p_value(other, one, samples)
        called += min(p_values) < SIGNIFICANCE
    assert called <= 0.09 * 500


@pytest.mark.parametrize(
    ("one", "other", "better"),
    [
        ([1.0, 1.2, 0.9, 1.1], [2.0, 2.4, 1.8, 2.2], True),
        ([1.0, 1.0, 1.0], [1.0, np.inf, 1.0], True),
        ([1.0, 1.2, 0.9, 1.1], [1.0, 1.2, 0.9, 1.1], False),
        ([1.0, np.inf, 1.0], [1.0, np.inf, 1.0], False),
        ([1.0], [9.0], False),
    ],
    ids=["half the error", "the other diverged", "alike", "both diverged", "one test"],
)
def test_what_errs_half_as_much_surely_errs_less(one, other, better):
    samples = np.array([1000, 500, 1000, 800])[: len(one)]
    assert (better_p_value(np.array(one), np.array(other), samples) < SIGNIFICANCE) == better
    assert not better_p_value(np.array(other), np.array(one), samples) < SIGNIFICANCE


def test_the_p_value_is_that_of_students_t():
    """Equal sample counts and log ratios from a known sample: the jackknife's t is compared with scipy's."""
    rng = np.random.default_rng(5)
    errors, other = rng.uniform(1, 2, 8), rng.uniform(1.2, 2.4, 8)
    samples = np.full(8, 100)

    def log_ratio(keep):
        return 0.5 * np.log(np.sum(other[keep] ** 2) / np.sum(errors[keep] ** 2))

    left = np.array([log_ratio(np.arange(8) != test) for test in range(8)])
    error = np.sqrt(7 / 8 * np.sum((left - left.mean()) ** 2))
    expected = stats.t.sf(log_ratio(np.full(8, True)) / error, df=7)
    assert better_p_value(errors, other, samples) == pytest.approx(expected, rel=1e-10)
    assert better_p_value(other, errors, samples) == pytest.approx(1 - expected, rel=1e-10)


p_values = st.lists(st.floats(0, 1), min_size=1, max_size=12)


@given(p_values)
def test_holm_adjusts_by_its_definition(values):
    """Each adjusted value is the largest of (m − i) p over the p-values up to its own, at most 1."""
    ordered, adjusted = sorted(values), holm(values)
    for value, result in zip(values, adjusted, strict=True):
        products = [(len(values) - i) * p for i, p in enumerate(ordered[: ordered.index(value) + 1])]
        assert result == min(1.0, max(products))


def test_independent_errors_are_counted():
    """τ of a first-order process is (1 + φ)/(1 − φ); of 40 000 errors it shows to some percent."""
    rng = np.random.default_rng(4)
    white = rng.standard_normal((20, 2000))
    assert independent_observations(white) == pytest.approx(white.size, rel=0.1)
    correlated = lfilter([1.0], [1.0, -0.9], white, axis=1)
    assert independent_observations(correlated) == pytest.approx(white.size / 19, rel=0.15)


def test_an_error_of_a_whole_test_counts_once():
    tests = np.random.default_rng(5).standard_normal((30, 1)) * np.ones(500)
    # Of constant errors ρ falls evenly to zero at the length of a test: the sum of a triangle is half of it.
    assert independent_observations(tests) == pytest.approx(30, rel=0.02)
    # Samples that do not count, behind each test, change nothing.
    assert independent_observations(np.pad(tests, ((0, 0), (0, 300)))) == pytest.approx(
        independent_observations(tests), rel=1e-9
    )


def test_without_errors_nothing_is_told():
    assert independent_observations(np.zeros((3, 100))) == 0.0
