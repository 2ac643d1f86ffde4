"""Constants of the robust weights against integrals over the normal distribution."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, norm

from hitchid.fleet.random_effects import CLIP, constants_of, normal_constants, weights


def expectation(function, parameters, limit):
    """Return the mean of a function of d² ~ χ²ₚ, by quadrature on both sides of the limit."""
    parts = [(0.0, limit), (limit, np.inf)]
    return sum(quad(lambda x: function(x) * chi2.pdf(x, parameters), *part)[0] for part in parts)


@pytest.mark.parametrize("parameters", [1, 2, 5])
def test_consistency_and_efficiency_are_integrals(parameters):
    constants = normal_constants(parameters)
    limit = constants.clip

    def clipped_at(scale):
        return expectation(lambda x: min(x / scale, limit), parameters, limit * scale)

    mean = clipped_at(1.0)
    assert constants.consistency == pytest.approx(mean / parameters, rel=1e-6)
    variance = expectation(lambda x: min(x, limit) ** 2, parameters, limit) - mean**2
    step = 1e-3  # central difference: its error is of the order of the square
    slope = (clipped_at(1 - step) - clipped_at(1 + step)) / (2 * step)
    # By the delta method the variance of log σ² is variance/slope² over n; that of the plain estimate 2/p.
    assert constants.efficiency == pytest.approx(2 / parameters * slope**2 / variance, rel=1e-4)


def test_the_mean_of_one_parameter_has_the_variance_of_its_score():
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


def test_plain_weights_are_one():
    assert np.all(weights(np.array([0.0, 1.0, 1e12]), constants_of(1, robust=False).clip) == 1.0)
