"""The random-effects regression and its constants against closed forms, integrals and simulated fleets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import chi2, norm
from simulated_fleets import binomial_tolerance, simulated_fleet

from hitchid.errors import InputError
from hitchid.fleet.random_effects import (
    CLIP,
    LEVEL,
    PLAIN,
    adjusted_p_values,
    checked_estimates,
    fit_random_effects,
    normal_constants,
    spread_interval,
    weights,
)

NORMAL = np.random.default_rng(0).standard_normal(40)
ESTIMATES, COVARIANCES = np.zeros((4, 2)), np.tile(np.eye(2), (4, 1, 1))


def fit(values, variances, design=None):
    design = np.ones((len(values), 1)) if design is None else design
    return fit_random_effects(values, variances, design, np.ones((1, len(values)), bool))


def test_balanced_estimates_have_the_variance_of_the_sample(without_weights):
    effects = fit(5 + 2 * NORMAL, np.full(40, 0.5))
    sample = np.var(5 + 2 * NORMAL, ddof=1)
    assert effects.coefficients[0, 0] == pytest.approx(np.mean(5 + 2 * NORMAL), rel=1e-9)
    assert effects.between[0] == pytest.approx(sample - 0.5, rel=1e-7)
    assert effects.covariance[0, 0, 0] == pytest.approx(sample / 40, rel=1e-7)
    # The variance of a sample variance of n normal values is 2 σ⁴/(n − 1).
    assert effects.between_variance[0] == pytest.approx(2 * sample**2 / 39, rel=1e-7)


def test_a_scatter_below_the_errors_is_no_spread():
    assert fit(0.1 * NORMAL, np.ones(40)).between[0] == 0.0
    assert spread_interval(0.02 * NORMAL, np.ones(40)) == (0.0, 0.0)


def test_two_balanced_groups_have_the_pooled_variance(without_weights):
    group = np.arange(40) % 2
    design = np.stack([group == 0, group == 1], axis=1).astype(float)
    effects = fit(NORMAL + 10 * group, np.full(40, 0.1), design)
    pooled = (np.var(NORMAL[::2], ddof=1) + np.var(NORMAL[1::2], ddof=1)) / 2
    assert effects.between[0] == pytest.approx(pooled - 0.1, rel=1e-7)
    assert effects.coefficients[0] == pytest.approx([NORMAL[::2].mean(), 10 + NORMAL[1::2].mean()])


def test_unequal_errors_solve_the_restricted_score(without_weights):
    fleet = simulated_fleet(np.random.default_rng(1), 60)
    values, variances = fleet.estimates[:, 0], fleet.covariances[:, 0, 0]
    between = fit(values, variances).between[0]

    def deviance(tau2):
        precision = 1 / (variances + tau2)
        mean = precision @ values / precision.sum()
        return precision @ (values - mean) ** 2 - np.log(precision).sum() + np.log(precision.sum())

    step = 0.01 * between
    # The minimum of a parabola through three points: its error is of third order in the step.
    below, middle, above = (deviance(between + shift) for shift in (-step, 0, step))
    offset = step / 2 * (below - above) / (below - 2 * middle + above)
    assert abs(offset) < 1e-3 * between


def test_selections_are_fitted_as_if_alone():
    fleet = simulated_fleet(np.random.default_rng(2), 30)
    values, variances, ones = fleet.estimates[:, 0], fleet.covariances[:, 0, 0], np.ones((30, 1))
    together = fit_random_effects(values, variances, ones, ~np.eye(30, dtype=bool))
    for left_out in (0, 17, 29):
        others = np.arange(30) != left_out
        alone = fit(values[others], variances[others])
        assert together.between[left_out] == pytest.approx(alone.between[0], rel=1e-6)
        assert together.coefficients[left_out] == pytest.approx(alone.coefficients[0], abs=1e-8)
        assert together.weights[left_out, left_out] == 0.0


def test_the_robust_variance_is_that_of_a_normal_fleet():
    machines, between = 20_000, 2.0
    fleet = simulated_fleet(np.random.default_rng(3), machines, between=((between,),), errors=(1.0, 1.0))
    effects = fit(fleet.estimates[:, 0], fleet.covariances[:, 0, 0])
    error = (between + 1.0) * np.sqrt(2 / machines / normal_constants().efficiency)
    assert abs(effects.between[0] - between) < 4 * error
    assert np.sqrt(effects.between_variance[0]) == pytest.approx(error, rel=0.03)


def test_an_outlier_counts_the_same_however_far_it_is():
    variances = np.full(40, 0.1)
    near, far = (fit(np.append(NORMAL[1:], outlier), variances) for outlier in (20.0, 2e6))
    assert far.between[0] == pytest.approx(near.between[0], rel=1e-2)
    # Plain estimates are dragged along: the mean by a fortieth of the distance.
    assert abs(far.coefficients[0, 0] - np.mean(NORMAL[1:])) < 0.1


@given(st.floats(1e-3, 1e3), st.floats(-100, 100), st.integers(0, 10**6))
def test_the_unit_of_a_parameter_does_not_matter(scale, offset, seed):
    fleet = simulated_fleet(np.random.default_rng(seed), 20)
    values, variances = fleet.estimates[:, 0], fleet.covariances[:, 0, 0]
    one, other = fit(values, variances), fit(scale * (values + offset), scale**2 * variances)
    assert other.between[0] == pytest.approx(scale**2 * one.between[0], rel=1e-5, abs=1e-7 * scale**2)
    mean = scale * (one.coefficients[0, 0] + offset)
    assert other.coefficients[0, 0] == pytest.approx(mean, abs=1e-6 * scale)


# --- the interval of the spread -----------------------------------------------------------------------------


def test_equal_errors_have_the_interval_of_a_variance(without_weights):
    values = 2 * NORMAL
    squares = np.sum((values - values.mean()) ** 2)
    ends = squares / chi2.ppf([(1 + LEVEL) / 2, (1 - LEVEL) / 2], 39) - 0.5
    interval = spread_interval(values, np.full(40, 0.5))
    assert interval == pytest.approx(tuple(np.sqrt(ends)), rel=1e-6)


@pytest.mark.parametrize("spread", [0.0, 0.5, 2.0])
def test_the_interval_holds_the_spread_as_often_as_it_says(spread):
    rng, inside, fleets = np.random.default_rng(1), 0, 60
    for _ in range(fleets):
        fleet = simulated_fleet(rng, 25, between=((spread**2,),))
        lower, upper = spread_interval(fleet.estimates[:, 0], fleet.covariances[:, 0, 0])
        inside += lower <= spread <= upper
    # Not above for the robust χ², which is narrower than its approximation at the ends.
    assert inside / fleets > LEVEL - binomial_tolerance(LEVEL, fleets)


# --- robust weights -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("parameters", [1, 2, 5])
def test_consistency_and_efficiency_are_integrals(parameters):
    constants = normal_constants(parameters)
    limit = constants.clip

    def expectation(function, limit):
        """Return the mean of a function of d² ~ χ²ₚ, by quadrature on both sides of the limit."""
        parts = [(0.0, limit), (limit, np.inf)]
        return sum(quad(lambda x: function(x) * chi2.pdf(x, parameters), *part)[0] for part in parts)

    def clipped_at(scale):
        return expectation(lambda x: min(x / scale, limit), limit * scale)

    mean = clipped_at(1.0)
    assert constants.consistency == pytest.approx(mean / parameters, rel=1e-6)
    variance = expectation(lambda x: min(x, limit) ** 2, limit) - mean**2
    step = 1e-3  # central difference: its error is of the order of the square
    slope = (clipped_at(1 - step) - clipped_at(1 + step)) / (2 * step)
    # By the delta method the variance of log σ² is variance/slope² over n; that of the plain estimate 2/p.
    assert constants.efficiency == pytest.approx(2 / parameters * slope**2 / variance, rel=1e-4)


def test_the_mean_has_the_variance_of_its_score():
    def score(z):
        return z * min(1.0, CLIP**2 / z**2) if z else 0.0

    def expected(function):
        return 2 * (quad(function, 0, CLIP)[0] + quad(function, CLIP, 12)[0])

    squared = expected(lambda z: score(z) ** 2 * norm.pdf(z))
    slope = expected(lambda z: score(z) * z * norm.pdf(z))  # E ψ′ = E ψ z, by parts
    assert normal_constants().mean_factor == pytest.approx(squared / slope**2, rel=1e-6)


def test_the_influence_of_an_outlier_is_bounded():
    clip = normal_constants().clip
    squared = np.array([0.0, clip / 2, clip, 10 * clip, 1e12])
    assert weights(squared, clip) * squared == pytest.approx([0.0, clip / 2, clip, clip, clip])
    assert np.all(weights(squared, PLAIN.clip) == 1.0)


# --- many tests at once -------------------------------------------------------------------------------------


def test_the_paper_s_example_has_four_discoveries_whatever_is_missing():
    """Benjamini & Hochberg 1995, section 3.2: of 15 tests four are discoveries at a rate of 0.05."""
    small = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459]
    p_values = np.array([*small, 0.324, 0.4262, 0.5719, 0.6528, 0.759, 1.0, np.nan])
    adjusted = adjusted_p_values(p_values.reshape(4, 4)).ravel()
    assert np.flatnonzero(adjusted <= 0.05).tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(adjusted[[3, 14, 15]], [15 * 0.0095 / 4, 1.0, np.nan], rtol=1e-12)
    assert np.isnan(adjusted_p_values(np.full(3, np.nan))).all()


# --- estimates that cannot be used --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("estimates", "covariances", "message"),
    [
        (np.zeros(4), COVARIANCES, r"estimates: got shape \(4,\)"),
        (ESTIMATES, COVARIANCES[:3], r"covariances: got shape \(3, 2, 2\), expected \(4, 2, 2\)"),
        (np.full((4, 2), np.inf), COVARIANCES, "infinite"),
        (ESTIMATES, -COVARIANCES, "smallest eigenvalue -1"),
        (ESTIMATES, np.ones((4, 2, 2)) + np.diag([0, -0.5]), "machine 0"),
    ],
)
def test_estimates_that_cannot_be_used_are_refused(estimates, covariances, message):
    with pytest.raises(InputError, match=message):
        checked_estimates(estimates, covariances)


def test_a_parameter_without_estimate_or_error_is_missing_in_both():
    estimates, covariances = ESTIMATES.copy(), COVARIANCES.copy()
    estimates[1, 0] = np.nan
    covariances[2, 1, 1] = np.nan
    values, errors = checked_estimates(estimates, covariances)
    missing = np.zeros((4, 2), bool)
    missing[1, 0] = missing[2, 1] = True
    assert np.array_equal(np.isnan(values), missing)
    assert np.array_equal(np.isnan(errors), missing[:, :, None] | missing[:, None, :])
