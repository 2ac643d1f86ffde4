"""Trends of machines that were identified several times, against known slopes."""

import numpy as np
import pytest
from simulated_fleets import binomial_tolerance

from hitchid.errors import InputError
from hitchid.fleet.outliers import LEVEL, fit_trends

TIMES = np.array([0.0, 300.0, 500.0, 1200.0, 2000.0])  # h


def identifications(rng, slopes, *, excess=1.0, times=TIMES):
    """Return machines, times, estimates and covariances; true errors are `excess` times those stated."""
    machines = np.repeat(np.arange(len(slopes)), len(times))
    hours = np.tile(times, len(slopes))
    errors = rng.uniform(0.005, 0.02, len(machines))
    starts = 0.1 * rng.standard_normal(len(slopes))
    line = starts[machines] + np.asarray(slopes)[machines] * hours
    estimates = line + excess * errors * rng.standard_normal(len(machines))
    return machines, hours, estimates[:, None], (errors**2)[:, None, None]


def test_the_slope_is_that_of_weighted_least_squares():
    table = identifications(np.random.default_rng(0), [1e-5, -2e-5])
    trends = fit_trends(*table)
    weights = 1 / np.sqrt(table[3][:5, 0, 0])
    (slope, _), covariance = np.polyfit(TIMES, table[2][:5, 0], 1, w=weights, cov="unscaled")
    assert trends.slopes[0, 0] == pytest.approx(slope, rel=1e-9)
    assert trends.errors[0, 0] == pytest.approx(trends.scatter[0] * np.sqrt(covariance[0, 0]), rel=1e-9)


@pytest.mark.parametrize("excess", [1.0, 2.0])
def test_intervals_hold_the_slopes_also_where_errors_are_understated(excess):
    machines = 400
    slopes = 1e-5 * np.random.default_rng(1).standard_normal(machines)
    trends = fit_trends(*identifications(np.random.default_rng(2), slopes, excess=excess))
    # The factor is trends from 3 · 400 degrees of freedom.
    assert trends.scatter[0] == pytest.approx(excess, rel=4 / np.sqrt(2 * 0.88 * 1200))
    inside = np.mean((trends.lower[:, 0] <= slopes) & (slopes <= trends.upper[:, 0]))
    assert inside == pytest.approx(LEVEL, abs=0.01 + binomial_tolerance(LEVEL, machines))


def test_the_fleet_has_the_mean_slope():
    rng, inside, fleets = np.random.default_rng(4), 0, 100
    for _ in range(fleets):
        slopes = 2e-5 + 1e-5 * rng.standard_normal(25)
        ((lower, upper),) = fit_trends(*identifications(rng, slopes)).fleet_intervals
        inside += lower <= 2e-5 <= upper
    assert inside / fleets > LEVEL - binomial_tolerance(LEVEL, fleets)


def test_two_times_have_a_slope_and_one_has_none():
    machines, times, estimates, covariances = identifications(
        np.random.default_rng(5), [1e-5, 1e-5], times=TIMES[[0, 4]]
    )
    trends = fit_trends(machines[:3], times[:3], estimates[:3], covariances[:3])
    assert trends.slopes[0, 0] == pytest.approx((estimates[1, 0] - estimates[0, 0]) / 2000.0)
    assert trends.errors[0, 0] == pytest.approx(np.sqrt(covariances[:2].sum()) / 2000.0)
    # No scatter about the lines: the stated errors are taken as known.
    assert (trends.upper - trends.lower)[0, 0] == pytest.approx(2 * 1.959964 * trends.errors[0, 0], rel=1e-6)
    assert np.isnan(trends.slopes[1, 0])
    assert np.isnan(trends.fleet_slopes[0])


def test_one_time_has_no_slope():
    machines, times, estimates, covariances = identifications(np.random.default_rng(6), [0.0])
    trends = fit_trends(machines, np.full(5, 100.0), estimates, covariances)
    assert np.isnan(trends.slopes).all()
    assert trends.ranking == ()
    with pytest.raises(InputError, match="finite times"):
        fit_trends(machines, times + np.nan, estimates, covariances)
