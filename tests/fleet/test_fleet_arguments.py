"""Estimates of a fleet that cannot be used are refused by name."""

import numpy as np
import pytest

from hitchid.errors import InputError
from hitchid.fleet.random_effects import checked_estimates

ESTIMATES, COVARIANCES = np.zeros((4, 2)), np.tile(np.eye(2), (4, 1, 1))


@pytest.mark.parametrize(
    ("estimates", "covariances", "message"),
    [
        (np.zeros(4), COVARIANCES, r"estimates: got shape \(4,\)"),
        (ESTIMATES, COVARIANCES[:3], r"covariances: got shape \(3, 2, 2\), expected \(4, 2, 2\)"),
        (np.full((4, 2), np.inf), COVARIANCES, "infinite"),
        (ESTIMATES, -COVARIANCES, "smallest eigenvalue -1"),
        (ESTIMATES, np.ones((4, 2, 2)) + np.diag([0, -0.5]), "machine 0"),
    ],
)
def test_what_cannot_be_used_is_refused(estimates, covariances, message):
    with pytest.raises(InputError, match=message):
        checked_estimates(estimates, covariances)


def test_a_parameter_without_estimate_or_error_is_missing_in_both():
    estimates, covariances = ESTIMATES.copy(), COVARIANCES.copy()
    estimates[1, 0] = np.nan
    covariances[2, 1, 1] = np.nan
    values, errors = checked_estimates(estimates, covariances)
    missing = np.zeros((4, 2), bool)
    missing[1, 0] = missing[2, 1] = True
    assert np.array_equal(np.isnan(values), missing)
    assert np.array_equal(np.isnan(errors), missing[:, :, None] | missing[:, None, :])
