"""Outliers of simulated fleets whose sound and faulty machines are known."""

import numpy as np
import pytest
from scipy.stats import kstest
from simulated_fleets import binomial_tolerance, simulated_fleet

from hitchid.errors import InputError
from hitchid.fleet.outliers import FEWEST, POWER, find_outliers

TAILS = (0.001, 0.01, 0.05)


def p_values(machines, spread, errors, draws, seed=0):
    """Return p-values of sound machines: of all in each fleet."""
    rng = np.random.default_rng(seed)
    fleets = (
        simulated_fleet(rng, machines, between=((spread**2,),), errors=errors)
        for _ in range(draws // machines)
    )
    return np.concatenate([find_outliers(each.estimates, each.covariances).p_value[:, 0] for each in fleets])


@pytest.mark.parametrize("machines", [10, 50, 200])
@pytest.mark.parametrize("errors", [(1.0, 1.0), (0.4, 2.0)])
def test_p_values_of_sound_machines_are_uniform(machines, errors):
    found = p_values(machines, 3.0, errors, draws=1500)
    for tail in TAILS:
        assert np.mean(found < tail) < tail + binomial_tolerance(tail, found.size)
    # Largest distance from the uniform distribution: 2.2/√n at a level of 10⁻⁴, and 0.015 for ten machines,
    # where Student's t is an approximation of the robust variance.
    assert kstest(found, "uniform").statistic < 2.2 / np.sqrt(found.size) + (0.015 if machines == 10 else 0)


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_p_values_are_not_too_small_where_the_spread_is_within_the_errors(spread):
    found = p_values(25, spread, (0.5, 1.5), draws=4000)
    for tail in TAILS:
        assert np.mean(found < tail) < tail + binomial_tolerance(tail, found.size)


def faulty_fleet(rng, machines=100, faults=5, size=12.0):
    """Return a fleet of two parameters, and which of them are faulty: one of each of the first machines."""
    fleet = simulated_fleet(
        rng, machines, mean=(5.0, -2.0), between=((1.0, 0.3), (0.3, 1.0)), correlation=0.5
    )
    faulty = np.zeros((machines, 2), bool)
    faulty[np.arange(faults), rng.integers(0, 2, faults)] = True
    signs = rng.choice([-1.0, 1.0], faulty.shape)
    return fleet._replace(
        truth=fleet.truth + faulty * size * signs, estimates=fleet.estimates + faulty * size * signs
    ), faulty


def test_large_faults_are_named_and_the_false_discovery_rate_holds():
    rng, shares = np.random.default_rng(4), []
    for _ in range(60):
        fleet, faulty = faulty_fleet(rng)
        found = find_outliers(fleet.estimates, fleet.covariances, false_discovery_rate=0.2)
        assert found.named[faulty].all()
        shares.append(np.mean(~faulty[found.named]))
    assert np.mean(shares) < 0.2 + 4 * np.std(shares) / np.sqrt(len(shares))
    assert np.mean(shares) > 0.05  # the rate is used: a procedure that names only the obvious is not tested


def test_the_rate_holds_in_a_fleet_without_faults():
    rng, fleets = np.random.default_rng(5), 100
    named = [
        find_outliers(each.estimates, each.covariances).named.any()
        for each in (simulated_fleet(rng, 40, between=((4.0,),)) for _ in range(fleets))
    ]
    # Where everything is sound, the false discovery rate is the probability of any discovery.
    assert np.mean(named) < 0.1 + binomial_tolerance(0.1, fleets)


def test_intervals_of_named_machines_hold_their_deviation():
    rng, inside = np.random.default_rng(6), []
    for _ in range(60):
        fleet, _ = faulty_fleet(rng, size=5.0)
        found = find_outliers(fleet.estimates, fleet.covariances)
        true = (fleet.truth - [5.0, -2.0])[found.named]
        lower, upper = found.lower[found.named], found.upper[found.named]
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


def test_discoveries_are_ranked_by_p_value():
    fleet, _ = faulty_fleet(np.random.default_rng(8))
    found = find_outliers(fleet.estimates, fleet.covariances)
    ranked = [found.p_value[cell] for cell in found.ranking]
    assert len(ranked) == found.named.sum() >= 5
    assert ranked == sorted(ranked)


def test_machines_without_a_parameter_are_not_compared():
    fleet, _ = faulty_fleet(np.random.default_rng(9))
    estimates = fleet.estimates.copy()
    estimates[20:, 1] = np.nan
    estimates[7] = np.nan
    found = find_outliers(estimates, fleet.covariances)
    assert np.array_equal(np.isnan(found.p_value), np.isnan(estimates))
    assert not found.named[np.isnan(estimates)].any()


def test_a_large_fleet_is_left_out_in_groups():
    rng = np.random.default_rng(10)
    fleet = simulated_fleet(rng, 1000)
    found = find_outliers(fleet.estimates, fleet.covariances)
    total = np.sqrt(1.0 + fleet.covariances[:, 0, 0])
    # Mean and spread of the fleet are known to 2 and 4 %, by four standard deviations of a thousand machines.
    assert found.t[:, 0] == pytest.approx(fleet.estimates[:, 0] / total, rel=0.15, abs=0.2)


def test_few_machines_are_not_compared():
    fleet = simulated_fleet(np.random.default_rng(11), FEWEST - 1)
    found = find_outliers(fleet.estimates, fleet.covariances)
    assert np.isnan(found.p_value).all()
    assert not found.named.any()


@pytest.mark.parametrize("rate", [0.0, 1.0, np.nan])
def test_a_rate_outside_its_range_is_refused(rate):
    fleet = simulated_fleet(np.random.default_rng(12), 12)
    with pytest.raises(InputError, match="false_discovery_rate"):
        find_outliers(fleet.estimates, fleet.covariances, false_discovery_rate=rate)
