"""Least squares on errors of free runs: the refinement of the parameters of a simulation."""

from collections.abc import Callable

import numpy as np

ITERATIONS = 25  # of Levenberg and Marquardt; most fits end earlier by TOLERANCE; chosen
TOLERANCE = 1e-4  # relative decrease of the sum of squares below which a fit has ended; chosen
INITIAL_DAMPING, LESS, MORE, MAX_DAMPING = 1e-3, 0.2, 5.0, 1e8  # of Levenberg and Marquardt: common values

# Parameters to residuals, shape [R], and their derivative, shape [R, P].
Residuals = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def refine(parameters: np.ndarray, residuals: Residuals) -> np.ndarray:
    """Return parameters with a smaller sum of squared residuals; the same where they do not converge.

    Levenberg and Marquardt's method, scaled by the derivative. A start whose simulation diverges is returned
    as it is, a step to parameters whose simulation diverges is not taken.

    Args:
        parameters: start, shape [P].
        residuals: residuals and their derivative; not finite where a simulation diverges.
    """
    damping = INITIAL_DAMPING
    with np.errstate(all="ignore"):
        errors, derivative = residuals(parameters)
        cost = errors @ errors
        if not (np.isfinite(cost) and np.all(np.isfinite(derivative))):
            return parameters
        for _ in range(ITERATIONS):
            step = _step(errors, derivative, damping)
            new_errors, new_derivative = residuals(parameters + step)
            new_cost = new_errors @ new_errors
            if np.isfinite(new_cost) and np.all(np.isfinite(new_derivative)) and new_cost < cost:
                decrease = (cost - new_cost) / cost
                parameters, errors, derivative, cost = parameters + step, new_errors, new_derivative, new_cost
                damping *= LESS
                if decrease < TOLERANCE:
                    break
            else:
                damping *= MORE
                if damping > MAX_DAMPING:
                    break
    return parameters


def _step(errors: np.ndarray, derivative: np.ndarray, damping: float) -> np.ndarray:
    """Return the damped step; a parameter without influence stays."""
    norms = np.linalg.norm(derivative, axis=0)
    scaled = derivative / np.where(norms > 0, norms, 1.0)
    normal = scaled.T @ scaled + damping * np.eye(norms.size)
    return -np.linalg.solve(normal, scaled.T @ errors) / np.where(norms > 0, norms, 1.0)
