"""Outliers of simulated fleets whose sound and faulty machines are known."""

import numpy as np
import pytest
from scipy.stats import kstest
from simulated_fleets import binomial_tolerance, simulated_fleet

from hitchid.fleet.outliers import POWER, find_outliers


def assert_uniform_below(machines, spread, errors, draws):
    """Check that small p-values of sound machines are not too frequent, and return those of all fleets."""
    rng, fleets = np.random.default_rng(0), range(draws // machines)
    sound = (simulated_fleet(rng, machines, between=((spread**2,),), errors=errors) for _ in fleets)
    values = [find_outliers(fleet.estimates, fleet.covariances).p_value[:, 0] for fleet in sound]
    p_values = np.concatenate(values)
    for tail in (0.001, 0.01, 0.05):
        assert np.mean(p_values < tail) < tail + binomial_tolerance(tail, p_values.size)
    return p_values


@pytest.mark.parametrize("machines", [10, 50, 200])
@pytest.mark.parametrize("errors", [(1.0, 1.0), (0.4, 2.0)])
def test_p_values_of_sound_machines_are_uniform(machines, errors):
    p_values = assert_uniform_below(machines, 3.0, errors, draws=1500)
    # Largest distance from the uniform distribution: 2.2/√n at a level of 10⁻⁴, and 0.015 for ten machines,
    # where Student's t is an approximation of the robust variance.
    most = 2.2 / np.sqrt(p_values.size) + (0.015 if machines == 10 else 0)
    assert kstest(p_values, "uniform").statistic < most


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_a_spread_within_errors_makes_no_small_p_values(spread):
    assert_uniform_below(25, spread, (0.5, 1.5), draws=4000)


def faulty_fleet(rng, machines=100, faults=5, size=12.0):
    """Return a fleet of two parameters, and which of them are faulty: one of each of the first machines."""
    between = ((1.0, 0.3), (0.3, 1.0))
    fleet = simulated_fleet(rng, machines, mean=(5.0, -2.0), between=between, correlation=0.5)
    faulty = np.zeros((machines, 2), bool)
    faulty[np.arange(faults), rng.integers(0, 2, faults)] = True
    shift = faulty * size * rng.choice([-1.0, 1.0], faulty.shape)
    return fleet._replace(truth=fleet.truth + shift, estimates=fleet.estimates + shift), faulty


def test_large_faults_are_named_and_the_false_discovery_rate_holds():
    rng, shares = np.random.default_rng(4), []
    for _ in range(60):
        fleet, faulty = faulty_fleet(rng)
        outliers = find_outliers(fleet.estimates, fleet.covariances, false_discovery_rate=0.2)
        assert outliers.named[faulty].all()
        shares.append(np.mean(~faulty[outliers.named]))
    assert np.mean(shares) < 0.2 + 4 * np.std(shares) / np.sqrt(len(shares))
    assert np.mean(shares) > 0.05  # the rate is used: a procedure that names only the obvious is not tested


def test_intervals_of_named_machines_hold_their_deviation():
    rng, inside = np.random.default_rng(6), []
    for _ in range(60):
        fleet, _ = faulty_fleet(rng, size=5.0)
        outliers = find_outliers(fleet.estimates, fleet.covariances)
        true = (fleet.truth - [5.0, -2.0])[outliers.named]
        lower, upper = outliers.lower[outliers.named], outliers.upper[outliers.named]
        inside += list((lower <= true) & (true <= upper))
    assert np.mean(inside) > 0.9 - binomial_tolerance(0.9, len(inside))


def test_a_detectable_deviation_is_named_as_often_as_stated():
    rng, named, fleets = np.random.default_rng(7), [], 70
    for _ in range(fleets):
        fleet = simulated_fleet(rng, 50, errors=(1.0, 1.0))
        estimates, truth = fleet.estimates.copy(), fleet.truth
        detectable = find_outliers(estimates, fleet.covariances).detectable[0, 0]
        estimates[0] += detectable - truth[0]  # this is how far the machine itself is from the mean
        named.append(find_outliers(estimates, fleet.covariances).named[0, 0])
    # Errors of the mean and of the spread of fifty machines move the threshold of both alike.
    assert np.mean(named) == pytest.approx(POWER, abs=binomial_tolerance(POWER, fleets))


def test_discoveries_are_ranked_and_missing_parameters_not_compared():
    fleet, _ = faulty_fleet(np.random.default_rng(8))
    outliers = find_outliers(fleet.estimates, fleet.covariances)
    ranked = [outliers.p_value[cell] for cell in outliers.ranking]
    assert len(ranked) == outliers.named.sum() >= 5
    assert ranked == sorted(ranked)
    estimates = fleet.estimates.copy()
    estimates[20:, 1] = np.nan
    estimates[7] = np.nan
    outliers = find_outliers(estimates, fleet.covariances)
    assert np.array_equal(np.isnan(outliers.p_value), np.isnan(estimates))
    assert not outliers.named[np.isnan(estimates)].any()


def test_a_large_fleet_is_left_out_in_groups():
    rng = np.random.default_rng(10)
    fleet = simulated_fleet(rng, 1000)
    outliers = find_outliers(fleet.estimates, fleet.covariances)
    total = np.sqrt(1.0 + fleet.covariances[:, 0, 0])
    # Mean and spread of the fleet are known to 2 and 4 %, by four standard deviations of a thousand machines.
    assert outliers.t[:, 0] == pytest.approx(fleet.estimates[:, 0] / total, rel=0.15, abs=0.2)
