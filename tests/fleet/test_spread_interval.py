"""The interval of the spread against its closed form for equal errors, and against simulated fleets."""

import numpy as np
import pytest
from scipy.stats import chi2
from simulated_fleets import binomial_tolerance, simulated_fleet

from hitchid.fleet.random_effects import LEVEL, spread_interval

VALUES = 2 * np.random.default_rng(0).standard_normal(30)


def test_equal_errors_have_the_interval_of_a_variance():
    squares = np.sum((VALUES - VALUES.mean()) ** 2)
    lower, upper = spread_interval(VALUES, np.full(30, 0.5), robust=False)
    ends = squares / chi2.ppf([(1 + LEVEL) / 2, (1 - LEVEL) / 2], 29) - 0.5
    assert (lower, upper) == pytest.approx(tuple(np.sqrt(ends)), rel=1e-6)


def test_a_scatter_below_the_errors_reaches_zero():
    lower, upper = spread_interval(0.01 * VALUES, np.ones(30))
    assert lower == upper == 0.0


@pytest.mark.parametrize("spread", [0.0, 0.5, 2.0])
def test_it_holds_the_truth_as_often_as_it_says(spread):
    rng, inside, fleets = np.random.default_rng(1), 0, 60
    for _ in range(fleets):
        fleet = simulated_fleet(rng, 25, between=((spread**2,),))
        lower, upper = spread_interval(fleet.estimates[:, 0], fleet.covariances[:, 0, 0])
        inside += lower <= spread <= upper
    # Not above for the robust χ², which is narrower than its approximation at the ends.
    assert inside / fleets > LEVEL - binomial_tolerance(LEVEL, fleets)
