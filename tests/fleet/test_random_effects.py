"""The random-effects regression against balanced designs, where restricted maximum likelihood is closed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from simulated_fleets import simulated_fleet

from hitchid.fleet.random_effects import fit_random_effects, normal_constants

NORMAL = np.random.default_rng(0).standard_normal(40)


def fit(values, variances, design=None, *, robust=False):
    design = np.ones((len(values), 1)) if design is None else design
    return fit_random_effects(values, variances, design, np.ones((1, len(values)), bool), robust=robust)


def test_balanced_estimates_have_the_variance_of_the_sample():
    found = fit(5 + 2 * NORMAL, np.full(40, 0.5))
    sample = np.var(5 + 2 * NORMAL, ddof=1)
    assert found.coefficients[0, 0] == pytest.approx(np.mean(5 + 2 * NORMAL), rel=1e-9)
    assert found.between[0] == pytest.approx(sample - 0.5, rel=1e-7)
    assert found.covariance[0, 0, 0] == pytest.approx(sample / 40, rel=1e-7)
    # The variance of a sample variance of n normal values is 2 σ⁴/(n − 1).
    assert found.between_variance[0] == pytest.approx(2 * sample**2 / 39, rel=1e-7)


def test_a_scatter_below_the_errors_is_no_spread():
    assert fit(0.1 * NORMAL, np.ones(40)).between[0] == 0.0


def test_two_balanced_groups_have_the_pooled_variance():
    group = np.arange(40) % 2
    design = np.stack([group == 0, group == 1], axis=1).astype(float)
    found = fit(NORMAL + 10 * group, np.full(40, 0.1), design)
    pooled = (np.var(NORMAL[::2], ddof=1) + np.var(NORMAL[1::2], ddof=1)) / 2
    assert found.between[0] == pytest.approx(pooled - 0.1, rel=1e-7)
    assert found.coefficients[0] == pytest.approx([NORMAL[::2].mean(), 10 + NORMAL[1::2].mean()])


def test_unequal_errors_solve_the_restricted_score():
    fleet = simulated_fleet(np.random.default_rng(1), 60)
    values, variances = fleet.estimates[:, 0], fleet.covariances[:, 0, 0]
    between = fit(values, variances).between[0]

    def deviance(tau2):
        precision = 1 / (variances + tau2)
        mean = precision @ values / precision.sum()
        return precision @ (values - mean) ** 2 - np.log(precision).sum() + np.log(precision.sum())

    step = 0.01 * between
    # The minimum of a parabola through three points: its error is of third order in the step.
    below, middle, above = (deviance(between + each) for each in (-step, 0, step))
    offset = step / 2 * (below - above) / (below - 2 * middle + above)
    assert abs(offset) < 1e-3 * between


def test_selections_are_fitted_as_if_alone():
    fleet = simulated_fleet(np.random.default_rng(2), 30)
    values, variances, ones = fleet.estimates[:, 0], fleet.covariances[:, 0, 0], np.ones((30, 1))
    together = fit_random_effects(values, variances, ones, ~np.eye(30, dtype=bool))
    for left_out in (0, 17, 29):
        others = np.arange(30) != left_out
        alone = fit(values[others], variances[others], robust=True)
        assert together.between[left_out] == pytest.approx(alone.between[0], rel=1e-6)
        assert together.coefficients[left_out] == pytest.approx(alone.coefficients[0], abs=1e-8)
        assert together.weights[left_out, left_out] == 0.0


def test_the_robust_variance_is_that_of_a_normal_fleet():
    machines, between = 20_000, 2.0
    fleet = simulated_fleet(np.random.default_rng(3), machines, between=((between,),), errors=(1.0, 1.0))
    found = fit(fleet.estimates[:, 0], fleet.covariances[:, 0, 0], robust=True)
    error = (between + 1.0) * np.sqrt(2 / machines / normal_constants().efficiency)
    assert abs(found.between[0] - between) < 4 * error
    assert np.sqrt(found.between_variance[0]) == pytest.approx(error, rel=0.03)


def test_an_outlier_counts_the_same_however_far_it_is():
    variances = np.full(40, 0.1)
    near, far = (fit(np.append(NORMAL[1:], place), variances, robust=True) for place in (20.0, 2e6))
    assert far.between[0] == pytest.approx(near.between[0], rel=1e-2)
    # Plain estimates are dragged along: the mean by a fortieth of the distance.
    assert abs(far.coefficients[0, 0] - np.mean(NORMAL[1:])) < 0.1


@given(st.floats(1e-3, 1e3), st.floats(-100, 100), st.integers(0, 10**6))
def test_the_unit_of_a_parameter_does_not_matter(scale, offset, seed):
    fleet = simulated_fleet(np.random.default_rng(seed), 20)
    values, variances = fleet.estimates[:, 0], fleet.covariances[:, 0, 0]
    one = fit(values, variances, robust=True)
    other = fit(scale * (values + offset), scale**2 * variances, robust=True)
    assert other.between[0] == pytest.approx(scale**2 * one.between[0], rel=1e-5, abs=1e-7 * scale**2)
    assert other.coefficients[0, 0] == pytest.approx(
        scale * (one.coefficients[0, 0] + offset), abs=1e-6 * scale
    )
