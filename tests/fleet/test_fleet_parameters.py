"""Estimates of a row: what they are, and that their covariance can be used."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fleet_rows
from hitchid.fleet.parameters import (
    DEAD_ZONE,
    DELAY,
    GAIN,
    LOAD_SCATTER,
    NAMES,
    FleetParameter,
    Kind,
    estimates_of_row,
    kind_of,
)

TESTS, SCATTER, DRAWS = 9, 0.03, 4000


def test_estimates_have_the_errors_of_the_row():
    values, covariance = estimates_of_row(fleet_rows.figures("lifting"))
    assert np.exp(values[NAMES.index(GAIN)]) == pytest.approx(fleet_rows.GAINS["lifting"])
    assert values[NAMES.index(DEAD_ZONE)] == fleet_rows.DEAD_ZONES["lifting"]
    assert values[NAMES.index(DELAY)] == 0.08
    deviations = np.sqrt(np.diagonal(covariance))[:3]
    np.testing.assert_allclose(deviations, [fleet_rows.GAIN_ERROR, fleet_rows.DEAD_ZONE_ERROR, 0.003])
    assert covariance[0, 1] / deviations[0] / deviations[1] == pytest.approx(fleet_rows.CORRELATION)


def test_the_logarithm_of_a_scatter_has_no_bias():
    rng = np.random.default_rng(1)
    drawn = SCATTER * np.std(rng.standard_normal((DRAWS, TESTS)), axis=1, ddof=1)
    rows = (fleet_rows.figures("lifting", load_scatter=scatter, tests=TESTS) for scatter in drawn)
    estimates, covariances = zip(*map(estimates_of_row, rows), strict=True)
    logarithms, error = np.array(estimates)[:, 3], np.sqrt(covariances[0][3, 3])
    # Mean and standard deviation of that many draws, within four of their standard errors (kurtosis 3.5).
    assert np.mean(logarithms) == pytest.approx(np.log(100 * SCATTER), abs=4 * error / np.sqrt(DRAWS))
    assert np.std(logarithms) == pytest.approx(error, rel=4 * np.sqrt(2.5 / 4 / DRAWS))


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"gain_error": None}, GAIN),
        ({"gain": -1.0}, GAIN),
        ({"dead_zone_error": 0.0}, DEAD_ZONE),
        ({"delay_s": None, "delay_error_s": None}, DELAY),
        ({"delay_error_s": None}, DELAY),
        ({"load_scatter": None}, LOAD_SCATTER),
        ({"load_scatter": 0.0}, LOAD_SCATTER),
        ({"tests": 5}, LOAD_SCATTER),
    ],
)
def test_what_has_no_value_or_error_is_missing(changes, name):
    values, covariance = estimates_of_row(fleet_rows.figures("lifting", **changes))
    assert np.flatnonzero(np.isnan(values)).tolist() == [NAMES.index(name)]
    if name != GAIN or "gain_error" in changes:
        missing = np.isnan(np.diagonal(covariance))
        assert np.flatnonzero(missing).tolist() == [NAMES.index(name)]


@given(
    correlation=st.floats(-1, 1),
    gain_error=st.floats(1e-4, 1),
    dead_zone_error=st.floats(1e-5, 10),
    tests=st.integers(6, 100),
)
def test_every_covariance_is_positive_definite(**figures):
    covariance = estimates_of_row(fleet_rows.figures("lifting", **figures))[1]
    scale = np.sqrt(np.diagonal(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] > 0


def test_units_and_differences_are_of_the_row():
    kind = kind_of(fleet_rows.fleet(1)[0], "lowering")
    assert kind == Kind(fleet_rows.STRUCTURE, "mm", "A")
    assert [kind.unit(name) for name in NAMES] == ["mm/s/A", "A", "s", "%"]
    gain, delay = FleetParameter("lifting", GAIN, "mm/s/A"), FleetParameter("lifting", DELAY, "s")
    assert gain.difference(np.log(0.88)) == pytest.approx(-0.12)
    assert gain.value(np.log(50.0)) == pytest.approx(50.0)
    assert (delay.difference(0.1), delay.value(0.1)) == (0.1, 0.1)
