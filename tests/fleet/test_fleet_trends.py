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
    found = fit_trends(*table)
    weights = 1 / np.sqrt(table[3][:5, 0, 0])
    (slope, _), covariance = np.polyfit(TIMES, table[2][:5, 0], 1, w=weights, cov="unscaled")
    assert found.slopes[0, 0] == pytest.approx(slope, rel=1e-9)
    assert found.errors[0, 0] == pytest.approx(found.scatter[0] * np.sqrt(covariance[0, 0]), rel=1e-9)


@pytest.mark.parametrize("excess", [1.0, 2.0])
def test_intervals_hold_the_slopes_also_where_errors_are_understated(excess):
    machines = 400
    slopes = 1e-5 * np.random.default_rng(1).standard_normal(machines)
    found = fit_trends(*identifications(np.random.default_rng(2), slopes, excess=excess))
    # The factor is found from 3 · 400 degrees of freedom.
    assert found.scatter[0] == pytest.approx(excess, rel=4 / np.sqrt(2 * 0.88 * 1200))
    inside = np.mean((found.lower[:, 0] <= slopes) & (slopes <= found.upper[:, 0]))
    assert inside == pytest.approx(LEVEL, abs=0.01 + binomial_tolerance(LEVEL, machines))


def test_machines_that_drift_are_ranked_first():
    slopes = np.zeros(40)
    slopes[[7, 23]] = 1e-4, -5e-5  # 20 % and 10 % in 2000 h, with errors of one per cent
    found = fit_trends(*identifications(np.random.default_rng(3), slopes))
    assert {machine for machine, _ in found.ranking[:2]} == {7, 23}
    assert set(found.machines[found.q_values[:, 0] < 1e-4]) == {7, 23}


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
    found = fit_trends(machines[:3], times[:3], estimates[:3], covariances[:3])
    assert found.slopes[0, 0] == pytest.approx((estimates[1, 0] - estimates[0, 0]) / 2000.0)
    assert found.errors[0, 0] == pytest.approx(np.sqrt(covariances[:2].sum()) / 2000.0)
    # No scatter about the lines: the stated errors are taken as known.
    assert (found.upper - found.lower)[0, 0] == pytest.approx(2 * 1.959964 * found.errors[0, 0], rel=1e-6)
    assert np.isnan(found.slopes[1, 0])
    assert np.isnan(found.fleet_slopes[0])


def test_a_single_time_identified_twice_has_no_slope():
    machines, _, estimates, covariances = identifications(np.random.default_rng(6), [0.0])
    found = fit_trends(machines, np.full(5, 100.0), estimates, covariances)
    assert np.isnan(found.slopes).all()
    assert found.ranking == ()


def test_an_unknown_time_is_refused():
    machines, times, estimates, covariances = identifications(np.random.default_rng(7), [0.0])
    with pytest.raises(InputError, match="finite times"):
        fit_trends(machines, times + np.nan, estimates, covariances)
