"""Random-effects regression of one parameter over machines, robust to outlying ones."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid.fleet.robustness import constants_of, weights

ITERATIONS, TOLERANCE = 200, 1e-9  # of the variance; relative to the variance of an estimate; chosen
NORMAL_MAD = 1.4826  # standard deviation of a normal distribution, in its median absolute deviations
RECOVERY = 1.1  # growth of the share of a step that is taken, halved where steps alternate; chosen
START_SPREADS = 3.0  # scaled median absolute deviations at which values are cut for the first mean; chosen


class RandomEffects(NamedTuple):
    """Fits of y = X β + b + e, b ~ N(0, τ²), e ~ N(0, s²), one for each selection of machines.

    Attributes:
        coefficients: β, in the parameter's unit, shape [F, K].
        covariance: of β, shape [F, K, K].
        between: τ², variance between machines, the parameter's unit squared, shape [F].
        between_variance: variance of the estimate of τ², shape [F].
        weights: robust weight of each machine, zero where it is not selected, shape [F, N].
    """

    coefficients: Float[np.ndarray, "f k"]
    covariance: Float[np.ndarray, "f k k"]
    between: Float[np.ndarray, " f"]
    between_variance: Float[np.ndarray, " f"]
    weights: Float[np.ndarray, "f n"]


def fit_random_effects(
    values: Float[np.ndarray, " n"],
    variances: Float[np.ndarray, " n"],
    design: Float[np.ndarray, "n k"],
    selections: Bool[np.ndarray, "f n"],
    *,
    robust: bool = True,
) -> RandomEffects:
    """Return β and τ² of each selection of machines by restricted maximum likelihood with bounded influence.

    With V = s² + τ², z² = (y − X β)²/V and w = min(1, c²/z²): Σ w Xᵀ(y − X β)/V = 0 and
    Σ (w z²/κ − 1 + h)/V = 0, h the leverage; τ² = 0 where the second has no positive solution.

    Args:
        values: y, estimates of one parameter, shape [N].
        variances: s², squared standard errors, shape [N].
        design: X, shape [N, K]; a column of ones for a common mean.
        selections: machines of each fit, shape [F, N]; more than K in each.
        robust: False for plain restricted maximum likelihood, w = κ = 1.

    Source: Patterson & Thompson 1971; DerSimonian & Laird 1986; Richardson & Welsh 1995 (robust REML).
    """
    constants = constants_of(1, robust=robust)
    beta, between = _start(values, variances, design, selections)
    weight = np.ones(selections.shape)
    damping, previous = np.ones(len(selections)), np.zeros(len(selections))
    for _ in range(ITERATIONS):
        total = variances + between[:, None]
        precision = selections / total
        squared = (values - beta @ design.T) ** 2 / total
        weight = weights(squared, constants.clip)
        beta = _solve(_information(weight * precision, design), (weight * precision * values) @ design)
        leverage = _leverage(precision, design)
        score = np.sum(precision * (weight * squared / constants.consistency - 1 + leverage), axis=1)
        step = score / _variance_information(precision, design)
        change = np.maximum(0.0, between + step) - between
        if np.all(np.abs(change) <= TOLERANCE * np.min(total, axis=1)):
            break
        # With very unequal errors full steps may alternate.
        damping = np.where(change * previous < 0, damping / 2, np.minimum(1.0, RECOVERY * damping))
        between, previous = between + damping * change, change
    precision = selections / (variances + between[:, None])
    covariance = constants.mean_factor * np.linalg.inv(_information(precision, design))
    freedom = _variance_information(precision, design)
    return RandomEffects(beta, covariance, between, 2 / (constants.efficiency * freedom), weight * selections)


def _start(
    values: np.ndarray, variances: np.ndarray, design: np.ndarray, selections: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return β of the values without their extremes, and τ² of their median absolute deviation."""
    selected = np.where(selections, values, np.nan)
    centre = np.nanmedian(selected, axis=1)[:, None]
    spread = NORMAL_MAD * np.nanmedian(np.abs(selected - centre), axis=1)[:, None]
    cut = np.clip(values, centre - START_SPREADS * spread, centre + START_SPREADS * spread)
    beta = _solve(_information(selections * 1.0, design), (selections * cut) @ design)
    deviations = np.abs(np.where(selections, values - beta @ design.T, np.nan))
    scale = NORMAL_MAD * np.nanmedian(deviations, axis=1)
    error = np.nanmedian(np.where(selections, variances, np.nan), axis=1)
    return beta, np.maximum(0.0, scale**2 - error)


def _information(precision: np.ndarray, design: np.ndarray) -> np.ndarray:
    """Return Σ p Xᵀ X of each selection, shape [F, K, K]."""
    products = (design[:, :, None] * design[:, None, :]).reshape(len(design), -1)
    return (precision @ products).reshape(len(precision), design.shape[1], design.shape[1])


def _variance_information(precision: np.ndarray, design: np.ndarray) -> np.ndarray:
    """Return tr(P P), P = V⁻¹ − V⁻¹X(XᵀV⁻¹X)⁻¹XᵀV⁻¹, twice the information about τ², shape [F]."""
    leverage = _leverage(precision, design)
    ratio = np.linalg.solve(_information(precision, design), _information(precision**2, design))
    return np.sum(precision**2 * (1 - 2 * leverage), axis=1) + np.einsum("fkl,flk->f", ratio, ratio)


def _leverage(precision: np.ndarray, design: np.ndarray) -> np.ndarray:
    """Return the share of each machine in its own fitted value, shape [F, N]."""
    inverse = np.linalg.inv(_information(precision, design))
    return precision * np.sum((design @ inverse) * design, axis=2)


def _solve(matrices: np.ndarray, right_sides: np.ndarray) -> np.ndarray:
    return np.linalg.solve(matrices, right_sides[..., None])[..., 0]
