"""Bands hold the share of samples they are asked to, of tests that were not seen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hitchid.model import Bands, PredictionSpread
from hitchid.model.bands import free_run_half_width
from hitchid.uncertainty.conformal import (
    GRID,
    LEVELS,
    conformal_quantile,
    fewest_tests,
    growing_quantiles,
    nonconformity_scores,
    sensor_noise,
)

BANDS = Bands(
    ensemble=(),
    noise=0.1,
    levels=LEVELS,
    free_run=(0.5, 1.1, 1.4, 2.0),
    predictions=PredictionSpread(
        noise=0.1,
        exponent=0.5,
        horizons=(1, 10, 100),
        movements=(0.2, 2.0, 20.0),
        growths=(0.05, 0.2, 1.0),
        multipliers=((0.5, 1.0, 1.3, 1.6), (0.6, 1.2, 1.6, 2.4), (0.7, 1.4, 1.8, 3.0)),
    ),
    tests=(12, 12),
)
SETS = 150
SURE = 3.3  # standard errors, beyond which 1 in 1000 lies

scores = st.lists(
    st.lists(st.integers(0, 4000), min_size=1, max_size=12).map(lambda row: np.array(row) / 8),
    min_size=1,
    max_size=8,
)


@pytest.mark.parametrize(("tests", "level"), [(10, 0.5), (10, 0.8), (20, 0.9)])
def test_coverage_is_within_a_test_of_the_level(tests, level):
    drawn = np.random.default_rng(0).random((SETS, tests))
    quantiles = [conformal_quantile([np.full(30, score) for score in row], level) for row in drawn]
    # Of uniform scores a share q lies below q; the k-th of T uniform numbers is a Beta(k, T + 1 − k) one.
    error = np.sqrt(level * (1 - level) / (tests + 2) / SETS)
    assert abs(np.mean(quantiles) - level) <= 1 / (tests + 1) + SURE * error
    # Of few tests more is asked than they can tell: their largest score is returned.
    few = [np.full(9, float(number)) for number in range(5)]
    assert conformal_quantile(few, 0.9) == 4.0
    assert conformal_quantile(few, 0.5) < 4.0


@given(rows=scores, level=st.floats(0.01, 0.99), power=st.integers(-20, 20), seed=st.integers(0, 99))
def test_neither_unit_nor_order_of_scores_matters(rows, level, power, seed):
    rng, quantile = np.random.default_rng(seed), conformal_quantile(rows, level)
    # Powers of two scale without rounding.
    assert conformal_quantile([2.0**power * row for row in rows], level) == 2.0**power * quantile
    shuffled = [rng.permutation(rows[number]) for number in rng.permutation(len(rows))]
    assert conformal_quantile(shuffled, level) == pytest.approx(quantile, rel=1e-12)


@pytest.mark.parametrize("level", LEVELS)
def test_the_level_needs_no_raising_where_samples_are_independent(level):
    tests, samples = 20, 1000
    rng = np.random.default_rng(1)
    drawn = rng.random((20, tests, samples))
    computed = np.array([conformal_quantile(list(rows), level) for rows in drawn])
    # A binomial count of all samples, and quantiles between grid points 1/400 apart.
    error = np.sqrt(level * (1 - level) / (tests * samples))
    assert np.all(np.abs(computed - level) <= SURE * error + GRID[1])
    assert abs(computed.mean() - level) <= SURE * error / np.sqrt(20) + GRID[1]


def test_the_level_is_raised_where_tests_differ():
    rng, level = np.random.default_rng(2), 0.8
    raised = []
    for _ in range(40):
        sizes = np.exp(0.7 * rng.standard_normal((8, 1)))
        rows = sizes * np.abs(rng.standard_normal((8, 200)))
        raised.append(np.log(conformal_quantile(list(rows), level) / np.quantile(rows, level)))
    assert np.mean(raised) > SURE * np.std(raised) / np.sqrt(40)


@given(row=st.lists(st.floats(0, 1e6), min_size=1, max_size=20), level=st.floats(0.01, 0.99))
def test_of_one_test_the_largest_score_is_returned(row, level):
    assert conformal_quantile([np.array(row)], level) == max(row)


def test_noise_is_found_beside_what_is_smooth_or_broken():
    samples, size, rng = 4000, 0.05, np.random.default_rng(3)
    time_s = 0.01 * np.arange(samples)
    smooth = 10 * np.sin(np.pi * time_s) + 3 * time_s**2
    tests = [smooth + size * rng.standard_normal(samples) for _ in range(5)]
    computed = sensor_noise(tests)
    # Third differences are correlated, 1, −15/20, 6/20, −1/20: as good as N/(1 + 2 Σρ²) = N/2.31 independent
    # ones. Δ³ of the sine is 10 (π/100)³ = 3e-4 against √20 · 0.05 = 0.22: 1e-6 of the variance. The median
    # of five tests scatters less than one of them.
    degrees = samples / 2.31
    least, most = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], degrees) / degrees)
    assert least <= computed / size <= most
    # One broken test moves the median to the next of four whose scatter is √(2.31/2N) = 1.7 %.
    assert sensor_noise([*tests[:4], 100 * tests[4]]) == pytest.approx(computed, rel=SURE * 0.017)


def test_a_parabola_or_three_samples_have_no_noise():
    # Rounding of 1e4.
    assert sensor_noise([np.arange(100.0) ** 2]) <= 8 * np.finfo(float).eps * 1e4
    assert sensor_noise([np.array([0.0, 5.0, -5.0])]) == 0.0
    assert sensor_noise([]) == 0.0


@given(
    errors=st.lists(st.floats(-10, 10), min_size=1, max_size=20).map(np.array),
    spread=st.floats(1e-3, 10),
    noise=st.floats(0, 1),
    level=st.sampled_from(LEVELS),
)
def test_a_samples_score_has_a_band_that_reaches_it(errors, spread, noise, level):
    (computed,) = nonconformity_scores([errors], [np.full(errors.size, spread)], noise, level)
    floor = stats.norm.ppf(0.5 + level / 2) * noise
    # √(e² − f²) and back: rounding of squares of at most 100.
    np.testing.assert_allclose(
        np.hypot(floor, computed * spread), np.maximum(np.abs(errors), floor), atol=1e-6, rtol=0
    )
    assert np.all(computed[np.abs(errors) <= floor] == 0)


def test_a_sample_where_all_alternatives_agree_scores_finitely():
    ((inside, outside),) = nonconformity_scores([np.array([0.01, 1.0])], [np.zeros(2)], 0.1, 0.95)
    assert inside == 0.0
    assert 1e6 < outside < np.inf


def test_between_levels_and_horizons_bands_are_interpolated():
    assert [BANDS.multiplier(level) for level in LEVELS] == list(BANDS.free_run)
    assert BANDS.multiplier(0.85) == pytest.approx(1.25)
    spread, z = BANDS.predictions, stats.norm.ppf(0.95)
    for number, horizon in enumerate(spread.horizons):
        typical, growth, q = spread.movements[number], spread.growths[number], spread.multipliers[number][2]
        expected = np.sqrt(z**2 * 0.01 + q**2 * (0.01 + growth**2 * np.array([0.0, 1.0, 4.0])))
        movement = typical * np.array([0.0, -1.0, 4**2 / 4])
        np.testing.assert_allclose(BANDS.half_width(0.9, horizon, movement), expected, rtol=1e-12)
    # On a logarithmic axis 3 lies at 0.477 between 1 and 10; of a piston at rest only the noise is uncertain.
    q = 1.3 + np.log10(3) * 0.3
    assert BANDS.half_width(0.9, 3, np.zeros(())) == pytest.approx(0.1 * np.hypot(z, q))


def test_beyond_the_last_horizon_errors_grow_in_proportion():
    z = stats.norm.ppf(0.95)
    # Of a movement in proportion, ten times the error at 100 samples; the noise and its factor stay.
    expected = np.sqrt(z**2 * 0.01 + 1.8**2 * (0.01 + 10.0**2))
    assert BANDS.half_width(0.9, 1000, np.array(200.0)) == pytest.approx(expected, rel=1e-12)
    widths = [float(BANDS.half_width(0.9, horizon, np.array(20.0))) for horizon in (100, 101, 150, 1000)]
    assert np.all(np.diff(widths) > 0)


@given(
    levels=st.tuples(st.floats(0.5, 0.95), st.floats(0.5, 0.95)).map(sorted),
    horizon=st.integers(1, 10**6),
    movement=st.floats(-1e9, 1e9),
)
def test_bands_are_nested_finite_and_never_narrower_than_the_noise(levels, horizon, movement):
    less, more = (float(BANDS.half_width(level, horizon, np.array(movement))) for level in levels)
    # Interpolation rounds.
    assert stats.norm.ppf(0.5 + levels[0] / 2) * 0.1 * (1 - 1e-12) <= less <= more * (1 + 1e-12) < np.inf
    narrow, wide = (free_run_half_width([BANDS], [np.ones(1)], level) for level in levels)
    assert narrow <= wide + 1e-12


@given(rows=scores, noise=st.floats(0, 100))
def test_factors_grow_with_the_level(rows, noise):
    factors = growing_quantiles(rows, [np.ones(row.size) for row in rows], noise)
    assert np.all(np.diff(factors) >= 0)
    assert np.all(np.isfinite(factors))


@pytest.mark.parametrize(("level", "fewest"), [(0.5, 1), (0.8, 4), (0.9, 9), (0.95, 19)])
def test_the_rank_of_a_level_requires_so_many_tests(level, fewest):
    assert fewest_tests(level) == fewest


@given(rows=scores)
def test_with_too_few_tests_every_test_has_its_share_inside(rows):
    # Quantiles of a test are taken on a grid and interpolated: one sample of each may be missed.
    quantile = conformal_quantile(rows, 0.9)
    assert len(rows) < fewest_tests(0.9)
    for row in rows:
        assert np.count_nonzero(row > quantile * (1 + 1e-9)) <= 0.1 * row.size + 1
