"""Checks of the estimates of a fleet."""

import numpy as np
from numpy.typing import ArrayLike

from hitchid.errors import InputError


def checked_estimates(estimates: ArrayLike, covariances: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates and covariances as arrays of numbers; NaN in either is a missing parameter in both.

    Args:
        estimates: of each machine, shape [N, P], NaN where missing.
        covariances: of the errors, shape [N, P, P].

    Raises:
        InputError: shapes that do not agree, an infinite value, a covariance that is not positive definite.
    """
    values, errors = np.array(estimates, float), np.array(covariances, float)
    if values.ndim != 2:
        raise InputError(f"estimates: got shape {values.shape}, expected [machines, parameters]")
    expected = (*values.shape, values.shape[1])
    if errors.shape != expected:
        raise InputError(f"covariances: got shape {errors.shape}, expected {expected}")
    if np.isinf(values).any() or np.isinf(errors).any():
        raise InputError("estimates and covariances: got an infinite number, expected finite numbers or NaN")
    missing = np.isnan(values) | np.isnan(np.diagonal(errors, axis1=1, axis2=2))
    values[missing] = np.nan
    errors[missing] = np.nan
    errors.swapaxes(1, 2)[missing] = np.nan
    _check_definite(errors, missing)
    return values, errors


def _check_definite(errors: np.ndarray, missing: np.ndarray) -> None:
    filled = np.where(missing[:, :, None] | missing[:, None, :], np.eye(missing.shape[1]), errors)
    smallest = np.linalg.eigvalsh((filled + filled.swapaxes(1, 2)) / 2)[:, 0] if filled.size else np.ones(0)
    wrong = np.flatnonzero(~(smallest > 0))
    if wrong.size:
        raise InputError(
            f"covariances: machine {wrong[0]}: got the smallest eigenvalue {smallest[wrong[0]]:.3g}, "
            "expected a positive one"
        )
