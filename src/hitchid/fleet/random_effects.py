"""Random-effects regression of one parameter over machines, robust to outlying ones."""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.optimize import root_scalar
from scipy.special import chdtr, chdtri, ndtr
from scipy.stats import false_discovery_control

from hitchid.errors import InputError

# Weights that bound the influence of outlying machines, and their constants at the normal distribution.

CLIP = 2.0  # standard deviations beyond which a machine loses weight; chosen: 88 % efficient for the variance
INSIDE = float(2 * ndtr(CLIP) - 1)  # share of a normal distribution within CLIP, for any number of parameters


class NormalConstants(NamedTuple):
    """Expectations of the weights for normally distributed estimates.

    Attributes:
        clip: squared distance c² beyond which the weight c²/d² is below one.
        consistency: κ = E[min(d², c²)] / p, by which the weighted squares are divided.
        efficiency: degrees of freedom of the robust variance, as a share of those of the plain one.
        mean_factor: variance of the robust mean, as a multiple of that of the plain one.
    """

    clip: float
    consistency: float
    efficiency: float
    mean_factor: float


# Of a machine without estimates: it has no distance and no share in any sum.
PLAIN = NormalConstants(float(np.finfo(float).max), 1.0, 1.0, 1.0)


@cache
def normal_constants(parameters: int = 1) -> NormalConstants:
    """Return the constants for vectors of some length, d² ~ χ²ₚ.

    The variance solves Σ min(d², c²)/κ = n p: its efficiency is 2 p F²/Var min(d², c²), F = P(χ²ₚ₊₂ < c²).
    The mean solves Σ w(d²) r = 0: its variance is p E[w² d²]/E[p w + 2 d² w′]² times that of the plain mean.

    Source: Huber 1981, Robust Statistics, proposal 2 and sec. 8 (M-estimates of a scatter matrix).
    """
    from scipy.integrate import quad
    from scipy.stats import chi2

    p = parameters
    # The same share of sound machines loses weight, however many parameters there are.
    clip = float(chdtri(p, 1 - INSIDE))
    inside, inside_2, inside_4 = (float(chdtr(p + more, clip)) for more in (0, 2, 4))
    outside = 1 - inside
    clipped = p * inside_2 + clip * outside
    variance = p * (p + 2) * inside_4 + clip**2 * outside - clipped**2
    # E[1/d²; d² > c²]
    inverse = float(quad(lambda square: chi2.pdf(square, p) / square, clip, np.inf)[0])
    squared_score = p * inside_2 + clip**2 * inverse
    slope = p * inside + (p - 2) * clip * inverse
    return NormalConstants(clip, clipped / p, 2 * p * inside_2**2 / variance, squared_score * p / slope**2)


def constants_of(parameters: int) -> NormalConstants:
    """Return the constants for vectors of some length; the plain ones without one."""
    return normal_constants(parameters) if parameters else PLAIN


def weights(squared: np.ndarray, clip: np.ndarray | float) -> np.ndarray:
    """Return min(1, c²/d²), of the shape of the squared distances."""
    return clip / np.maximum(squared, clip)


# Interval of the standard deviation of one parameter between machines.

LEVEL = 0.95  # of the interval
MEAN_ITERATIONS, MEAN_TOLERANCE = 100, 1e-9  # of the mean; relative to the smallest deviation; chosen
LARGEST = 1e6  # upper end of the search, in sums of squares of the values; chosen


def spread_interval(
    values: Float[np.ndarray, " n"], variances: Float[np.ndarray, " n"]
) -> tuple[float, float]:
    """Return the 95 % interval of τ, in the parameter's unit.

    Its ends are where Q(τ²) = Σ min(z², c²)/κ, z² = (y − μ)²/(s² + τ²), is a quantile of its distribution:
    ε Q ~ χ² with ε (n − 1) degrees of freedom, ε the efficiency of the robust variance, of estimates y with
    variances s².

    Source: Viechtbauer 2007, Confidence intervals for the amount of heterogeneity in meta-analysis.
    """
    constants = normal_constants()
    freedom = constants.efficiency * (values.size - 1)
    # A bracket for the root: the spread that Q leaves is far below the values' own sum of squares.
    largest = LARGEST * float(np.sum((values - np.median(values)) ** 2) + np.max(variances))

    def end(tail: float) -> float:
        quantile = float(chdtri(freedom, tail))

        def excess(between: float) -> float:
            return constants.efficiency * _clipped_squares(values, variances + between, constants) - quantile

        # The estimates scatter less than their errors explain: no spread is within the interval.
        if excess(0.0) <= 0:
            return 0.0
        solution = root_scalar(excess, bracket=(0.0, largest), method="brentq", rtol=MEAN_TOLERANCE)
        return float(np.sqrt(solution.root))

    return end((1 - LEVEL) / 2), end((1 + LEVEL) / 2)


def _clipped_squares(values: np.ndarray, total: np.ndarray, constants: NormalConstants) -> float:
    """Return Q for known variances; the robust mean is iterated from the median."""
    mean = float(np.median(values))
    for _ in range(MEAN_ITERATIONS):
        precision = weights((values - mean) ** 2 / total, constants.clip) / total
        updated = float(precision @ values / precision.sum())
        change, mean = abs(updated - mean), updated
        if change <= MEAN_TOLERANCE * np.sqrt(float(total.min())):
            break
    return float(np.minimum(constants.clip, (values - mean) ** 2 / total).sum() / constants.consistency)


# Many tests at once: adjusted p-values whose false discovery rate is controlled.


def adjusted_p_values(p_values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the smallest false discovery rate at which each test is a discovery.

    NaN is where there is no test, which is not counted.

    Source: Benjamini & Hochberg 1995, Controlling the false discovery rate.
    """
    # SciPy refuses NaN; and a pair that was not compared is no test that the others pay for.
    adjusted, tested = np.full(p_values.shape, np.nan), ~np.isnan(p_values)
    adjusted[tested] = false_discovery_control(p_values[tested])
    return adjusted


# Checks of the estimates of a fleet.


def checked_estimates(estimates: ArrayLike, covariances: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return estimates [N, P] and covariances [N, P, P] as arrays; NaN in either is a missing one in both.

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
    filled = np.where(missing[:, :, None] | missing[:, None, :], np.eye(missing.shape[1]), errors)
    smallest = np.linalg.eigvalsh((filled + filled.swapaxes(1, 2)) / 2)[:, 0] if filled.size else np.ones(0)
    wrong = np.flatnonzero(~(smallest > 0))
    if wrong.size:
        raise InputError(
            f"covariances: machine {wrong[0]}: got the smallest eigenvalue {smallest[wrong[0]]:.3g}, "
            "expected a positive one"
        )
    return values, errors


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
) -> RandomEffects:
    """Return β and τ² of each selection of machines by restricted maximum likelihood with bounded influence.

    With V = s² + τ², z² = (y − X β)²/V and w = min(1, c²/z²): Σ w Xᵀ(y − X β)/V = 0 and
    Σ (w z²/κ − 1 + h)/V = 0, h the leverage; τ² = 0 where the second has no positive solution. Of estimates y
    with variances s², design X (ones for a common mean) and more machines in each fit than columns of it.

    Source: Patterson & Thompson 1971; DerSimonian & Laird 1986; Richardson & Welsh 1995 (robust REML).
    """
    constants = normal_constants()
    beta, between = _start(values, variances, design, selections)
    weight = np.ones(selections.shape)
    damping, previous = np.ones(len(selections)), np.zeros(len(selections))
    for _ in range(ITERATIONS):
        total = variances + between[:, None]
        # All selections at once: leaving out each machine of a fleet is two hundred fits.
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
    # A plain mean would be dragged along by an outlier, by its distance over the number of machines.
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
