"""Cohorts of simulated fleets with known differences."""

import numpy as np
import pytest
from scipy.stats import kstest
from simulated_fleets import binomial_tolerance, simulated_fleet

from hitchid.errors import InputError
from hitchid.fleet.outliers import LEVEL, compare_cohorts

MACHINES = 60
TYPES = np.array(["small", "medium", "large"])
OFFSET = {"small": 0.0, "medium": 1.0, "large": 4.0}


def fleet_of(rng, *, types=None, ages=None, slope=0.0):
    fleet = simulated_fleet(rng, MACHINES, mean=(5.0, -1.0), between=((1.0, 0.0), (0.0, 1.0)))
    shift = np.zeros(MACHINES)
    if types is not None:
        shift += [OFFSET[name] for name in types]
    if ages is not None:
        shift += slope * ages
    return fleet._replace(estimates=fleet.estimates + np.outer(shift, [1.0, 0.0]))


def test_p_values_are_uniform_without_an_effect():
    rng, p_values = np.random.default_rng(0), []
    for _ in range(50):
        columns = {"type": rng.choice(TYPES, MACHINES), "age": rng.uniform(0, 5000, MACHINES)}
        fleet = fleet_of(rng)
        p_values += [
            effect.p_value for effect in compare_cohorts(fleet.estimates, fleet.covariances, columns)
        ]
    assert len(p_values) == 200
    for tail in (0.01, 0.05):
        assert np.mean(np.array(p_values) < tail) < tail + binomial_tolerance(tail, 200)
    assert kstest(p_values, "uniform").statistic < 2.2 / np.sqrt(200)  # at a level of 10⁻⁴


def test_means_and_slopes_are_held_by_their_intervals():
    rng, fleets, means, slopes = np.random.default_rng(1), 30, [], []
    for _ in range(fleets):
        types, ages = rng.choice(TYPES, MACHINES), rng.uniform(0, 5000, MACHINES)
        fleet = fleet_of(rng, types=types)
        effect, _ = compare_cohorts(fleet.estimates, fleet.covariances, {"type": types})
        assert effect.labels == ("large", "medium", "small")
        truths = [5.0 + OFFSET[label] for label in effect.labels]
        means += [low <= true <= high for (low, high), true in zip(effect.intervals, truths, strict=True)]
        fleet = fleet_of(rng, ages=ages, slope=1e-3)
        effect, _ = compare_cohorts(fleet.estimates, fleet.covariances, {"age": ages})
        slopes.append(effect.intervals[0][0] <= 1e-3 <= effect.intervals[0][1])
    assert np.mean(means) > LEVEL - binomial_tolerance(LEVEL, fleets)
    assert np.mean(slopes) > LEVEL - binomial_tolerance(LEVEL, fleets)


def test_unknown_cells_rare_categories_and_equal_columns_are_left_out():
    types = ["small"] * 28 + ["large"] * 28 + ["prototype"] * 2 + [None, ""]
    ages = [*map(float, range(58)), None, np.nan]
    fleet = fleet_of(np.random.default_rng(3))
    effects = compare_cohorts(fleet.estimates, fleet.covariances, {"type": types, "age": ages})
    assert [effect.machines for effect in effects] == [56, 56, 58, 58]
    assert effects[0].labels == ("large", "small")
    nothing = {"type": ["small"] * MACHINES, "age": np.full(MACHINES, 3.0), "empty": [None] * MACHINES}
    assert compare_cohorts(fleet.estimates, fleet.covariances, nothing) == ()


def test_a_column_of_another_length_is_refused():
    fleet = fleet_of(np.random.default_rng(5))
    with pytest.raises(InputError, match=r"'age': got 3 values, expected 60"):
        compare_cohorts(fleet.estimates, fleet.covariances, {"age": [1.0, 2.0, 3.0]})
