"""Parameters drawn from their estimates have the mean, the spread and the correlation of the estimates."""

from dataclasses import replace

import numpy as np
import pytest

import handmade
from hitchid.logs.record import LIFTING
from hitchid.model import Estimates
from hitchid.model.parameter_draws import draw_parameters
from report import reported

COUNT = 20_000
GAIN, OMEGA, DAMPING = handmade.GAINS[LIFTING], *handmade.VALUES["integrator-second-order"]


def estimate(name, value, error, *, lower=1e-6, upper=1e6, **options):
    bounds = {"interval": (None, None), "lower": lower, "upper": upper}
    return reported.estimate(name, value=value, error=error, **bounds, **options)


def estimates(*parameters, correlation=None):
    size = len(parameters)
    matrix = np.eye(size) if correlation is None else np.array(correlation)
    return Estimates(parameters, (), tuple(map(tuple, matrix.tolist())), 5, 5)


@pytest.fixture
def benchmark():
    return handmade.channel(LIFTING, "integrator-second-order", shape=True).benchmark


def test_logarithms_have_the_relative_standard_errors_and_the_correlation(benchmark):
    estimated = estimates(
        estimate("gain", GAIN, 0.1 * GAIN),
        estimate("natural_frequency", OMEGA, 0.2 * OMEGA),
        correlation=[[1.0, -0.8], [-0.8, 1.0]],
    )
    logarithms = np.log(draw_parameters(benchmark, estimated, COUNT, seed=0)[:, :2] / [GAIN, OMEGA])
    spread = np.array([0.1, 0.2])
    # Standard errors of mean, deviation and correlation over the draws; five of them.
    np.testing.assert_allclose(logarithms.mean(axis=0) / spread, 0, atol=5 / np.sqrt(COUNT))
    np.testing.assert_allclose(logarithms.std(axis=0) / spread, 1, atol=5 / np.sqrt(2 * COUNT))
    assert np.corrcoef(logarithms.T)[0, 1] == pytest.approx(-0.8, abs=5 * (1 - 0.8**2) / np.sqrt(COUNT))


def test_a_linear_parameter_is_drawn_as_it_is(benchmark):
    names = ["gain", "natural_frequency", "damping_ratio", "dead_time", "opening"]
    opening = float(benchmark.nonlinearity.values[0])
    estimated = estimates(estimate("opening", opening, 0.05, linear=True, lower=-10.0, upper=10.0))
    drawn = draw_parameters(benchmark, estimated, COUNT, seed=0)[:, names.index("opening")]
    assert (drawn.mean() - opening) / 0.05 == pytest.approx(0, abs=5 / np.sqrt(COUNT))
    assert drawn.std() / 0.05 == pytest.approx(1, abs=5 / np.sqrt(2 * COUNT))


def test_a_parameter_without_a_standard_error_keeps_its_value(benchmark):
    estimated = estimates(
        estimate("gain", GAIN, 0.1 * GAIN),
        estimate("damping_ratio", DAMPING, None),
        correlation=[[1.0, 0.0], [0.0, 0.0]],
    )
    drawn = draw_parameters(benchmark, estimated, 50, seed=0)
    kept = np.delete(drawn, 0, axis=1)
    np.testing.assert_allclose(kept, np.tile(np.asarray(benchmark.parameter_vector)[1:], (50, 1)), rtol=1e-15)
    assert drawn[:, 0].std() > 0


def test_draws_stay_within_the_bounds_of_the_search(benchmark):
    wide = estimate("gain", GAIN, 100 * GAIN, lower=0.5 * GAIN, upper=2 * GAIN)
    drawn = draw_parameters(benchmark, estimates(wide), 200, seed=0)[:, 0]
    assert {drawn.min(), drawn.max()} == {0.5 * GAIN, 2 * GAIN}


def test_a_bound_leaves_what_two_parameters_determine_together(benchmark):
    # Log gain and log frequency vary by 2, their sum by 0.01: beyond the bounds the sum is still known.
    spread, known_sum = 2.0, 0.01
    correlation = -1 + 0.5 * (known_sum / spread) ** 2
    estimated = estimates(
        estimate("gain", GAIN, spread * GAIN, lower=0.5 * GAIN, upper=2 * GAIN),
        estimate("natural_frequency", OMEGA, spread * OMEGA),
        correlation=[[1.0, correlation], [correlation, 1.0]],
    )
    logarithms = np.log(draw_parameters(benchmark, estimated, COUNT, seed=0)[:, :2] / [GAIN, OMEGA])
    assert np.abs(logarithms[:, 0]).max() == pytest.approx(np.log(2), rel=1e-12)
    assert logarithms.sum(axis=1).std() == pytest.approx(known_sum, rel=5 / np.sqrt(2 * COUNT))


def test_a_value_beyond_the_bounds_is_not_moved(benchmark):
    estimated = estimates(estimate("gain", GAIN, None, lower=2 * GAIN, upper=3 * GAIN))
    estimated = replace(estimated, correlation=((0.0,),))
    assert set(draw_parameters(benchmark, estimated, 5, seed=0)[:, 0]) == {GAIN}


def test_draws_follow_from_the_seed(benchmark):
    estimated = estimates(estimate("gain", GAIN, 0.1 * GAIN))
    one, same, other = (draw_parameters(benchmark, estimated, 10, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
