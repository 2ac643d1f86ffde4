"""Fisher information of the tests, with correlated errors, and expected errors after one more test."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import toeplitz

from hitchid.estimation import Objective
from hitchid.estimation.objective import GAIN_RIDGE
from hitchid.model.information import Information
from hitchid.uncertainty.influence import Influence

LAGS = 100  # blocks of the longest test, lags of the autocovariance; chosen


def information_of(objective: Objective, position: np.ndarray, influence: Influence) -> Information:
    """Return the Fisher information of the tests at the best position.

    Args:
        objective: identification tests and model specification.
        position: the estimates, shape [D].
        influence: influence of each test on each estimate.
    """
    errors, test = objective.errors(position)
    free = np.flatnonzero(np.any(influence.by_test != 0, axis=0))
    curvature = objective.equations_by_test(position).curvatures.sum(axis=0)[np.ix_(free, free)]
    covariance = (influence.by_test.T @ influence.by_test)[np.ix_(free, free)]
    counts = np.bincount(test)
    block_size = max(1, int(counts.max()) // LAGS)
    from_dead_zone = np.outer(influence.by_dead_zone[free], influence.by_dead_zone[free])
    return Information(
        names=tuple(objective.spec.parameters[number].name for number in free),
        slopes=tuple(map(float, objective.slopes(position)[free])),
        curvature=_rows(curvature),
        score_covariance=_rows(curvature @ covariance @ curvature),
        dead_zone_covariance=_rows(from_dead_zone),
        autocovariance=_autocovariance(errors, test, block_size),
        block_size=block_size,
        per_test_gain=objective.per_test_gain,
        tests=int(np.count_nonzero(counts)),
        samples=float(counts[counts > 0].mean()),
    )


def standard_errors(information: Information) -> Float[np.ndarray, " d"]:
    """Return the standard errors from the identification tests, in the unit cube."""
    return _standard_errors(
        information, np.array(information.curvature), np.array(information.score_covariance)
    )


def standard_errors_with_repeat(information: Information) -> Float[np.ndarray, " d"]:
    """Return the standard errors expected after one more test like the identification tests."""
    factor = 1 + 1 / information.tests
    return _standard_errors(
        information, factor * np.array(information.curvature), factor * np.array(information.score_covariance)
    )


def profile_out_gain(
    information: Information, travel: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, "n d"]:
    """Return the derivatives of a test without the component that the test's own gain absorbs.

    J − ŷ (ŷᵀJ)/((1 + ρ) ŷᵀŷ), to first order for a well fitted test; see `Objective.residuals`.

    Args:
        information: of the identification tests.
        travel: ŷ, simulated.
        jacobian: its derivative by the parameters in the unit cube.
    """
    if not information.per_test_gain:
        return jacobian
    return jacobian - np.outer(travel, travel @ jacobian / ((1 + GAIN_RIDGE) * (travel @ travel)))


def standard_errors_with(
    information: Information, jacobian: Float[np.ndarray, "n d"]
) -> Float[np.ndarray, " d"]:
    """Return the standard errors expected after one more test, in the unit cube.

    V' = H'⁻¹ (Σ gₜ gₜᵀ + Jᵀ C J) H'⁻¹, H' = H + Jᵀ J, with C the errors' covariance as in those tests.
    All tests have the same weight in the fit; a longer one has the smaller variance of its mean.

    Args:
        information: of the identification tests.
        jacobian: derivative of travel by the parameters in the unit cube, shape [N, D].
    """
    samples = jacobian.shape[0]
    blocks = -(-samples // information.block_size)
    padded = np.pad(jacobian, ((0, blocks * information.block_size - samples), (0, 0)))
    means = padded.reshape(blocks, information.block_size, -1).sum(axis=1)
    covariance = toeplitz(np.resize(np.append(information.autocovariance, np.zeros(blocks)), blocks))
    share = information.samples / samples
    return _standard_errors(
        information,
        np.array(information.curvature) + share * jacobian.T @ jacobian,
        np.array(information.score_covariance) + share**2 * means.T @ covariance @ means,
    )


def _standard_errors(
    information: Information, curvature: np.ndarray, score_covariance: np.ndarray
) -> np.ndarray:
    inverse = np.linalg.pinv(curvature, hermitian=True)
    return np.sqrt(np.diag(inverse @ score_covariance @ inverse + np.array(information.dead_zone_covariance)))


def _autocovariance(errors: np.ndarray, test: np.ndarray, block_size: int) -> tuple[float, ...]:
    """Return the autocovariance of the block means of the errors; biased, hence positive semidefinite."""
    rows = np.split(errors, np.flatnonzero(np.diff(test)) + 1)
    trimmed = [row[: len(row) // block_size * block_size] for row in rows if len(row) >= block_size]
    blocks = [row.reshape(-1, block_size).mean(axis=1) for row in trimmed]
    longest = max(len(row) for row in blocks)
    sums = np.zeros(longest)
    for row in blocks:
        sums[: len(row)] += np.correlate(row, row, "full")[len(row) - 1 :]
    return tuple(map(float, sums / sum(len(row) for row in blocks)))


def _rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)
