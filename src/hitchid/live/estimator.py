"""Estimate of the changes of one channel's parameters from its latest strokes: a Kalman filter over strokes.

The changes wander from stroke to stroke, and each stroke differs from them by a scatter of its own::

    θ(i+1) = θ(i) + w,   var w = Q
    r(i) = r₀(i) − J(i) (θ(i) + s(i) − θ₀) + v,   var s = Σ,   var v = I

with the standardised errors r₀ and their slopes at θ₀. Only JᵀJ, Jᵀr and rᵀr are needed. The strokes of the
window are linearised again at each estimate; what went before is the arrival cost.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from hitchid._support.records import short_repr
from hitchid.live.gates import Bounds
from hitchid.live.stroke_errors import StrokeFit

Vector = Float[np.ndarray, "3"]
Matrix = Float[np.ndarray, "3 3"]
ITERATIONS = 3  # linearisations of the window; the errors are almost linear in the changes; chosen


@short_repr
class Estimate(NamedTuple):
    """Changes of the parameters with the covariance of their error.

    Attributes:
        mean: log gain, dead zone in the command's unit, log lag, shape [3].
        covariance: shape [3, 3].
    """

    mean: Vector
    covariance: Matrix


def with_scatter(fit: StrokeFit, scatter: Matrix) -> StrokeFit:
    """Return a fit whose errors hold a scatter of the stroke's own: the same sums with (I + J Σ Jᵀ)⁻¹.

    By the matrix inversion lemma JᵀS⁻¹J = (I + H Σ)⁻¹H, JᵀS⁻¹r = (I + H Σ)⁻¹g and
    rᵀS⁻¹r = rᵀr − gᵀΣ (I + H Σ)⁻¹g, with H = JᵀJ and g = Jᵀr.
    """
    inverse = np.linalg.inv(np.eye(3) + fit.information @ scatter)
    information = inverse @ fit.information
    return fit._replace(
        squares=float(fit.squares - fit.gradient @ scatter @ inverse @ fit.gradient),
        gradient=inverse @ fit.gradient,
        information=0.5 * (information + information.T),
    )


def updated(prior: Estimate, fit: StrokeFit, drift: Matrix) -> Estimate:
    """Return the estimate after one more stroke; its mean is clear of what the stroke does not tell."""
    predicted = prior.covariance + drift
    covariance = predicted @ np.linalg.inv(np.eye(3) + fit.information @ predicted)
    covariance = 0.5 * (covariance + covariance.T)  # rounding would make it less symmetric with each stroke
    mean = prior.mean + covariance @ (fit.gradient - fit.information @ (prior.mean - fit.at))
    return Estimate(mean, covariance)


def restricted(fit: StrokeFit, free: Bool[np.ndarray, "3"], held_at: Vector) -> StrokeFit:
    """Return a fit of which only some parameters are free, the others held at their values."""
    # To first order the errors at the held values.
    shift = np.where(free, 0.0, held_at - fit.at)
    gradient = fit.gradient - fit.information @ shift
    return fit._replace(
        at=fit.at + shift,
        gradient=np.where(free, gradient, 0.0),
        information=np.where(np.outer(free, free), fit.information, 0.0),
    )


def conditional_mean(estimate: Estimate, free: Bool[np.ndarray, "3"], held_at: Vector) -> Vector:
    """Return the mean of the free parameters where the others have known values.

    m_f + P_fh P_hh⁻¹ (h − m_h), with the rows and columns of the free (f) and of the others (h).
    """
    covariance, held = estimate.covariance, ~free
    gain = covariance[np.ix_(free, held)] @ np.linalg.pinv(covariance[np.ix_(held, held)])
    mean = held_at.copy()
    mean[free] = estimate.mean[free] + gain @ (held_at[held] - estimate.mean[held])
    return mean


def window_estimate(
    fits_at: Callable[[Vector], Sequence[StrokeFit]],
    arrival: Estimate,
    drift: Matrix,
    allowed: Bool[np.ndarray, "3"],
) -> tuple[Estimate, Estimate]:
    """Return the estimate after the strokes of a window, and that after its first stroke.

    The second is the arrival cost of the window without that stroke. `fits_at` gives the fits of the strokes,
    the oldest first, at changes of the parameters; `arrival` is the estimate before the window, `drift` Q.
    """
    latest = first = arrival
    for _ in range(ITERATIONS):
        estimates = [arrival]
        for fit in fits_at(latest.mean):
            fit = restricted(fit, allowed, arrival.mean)  # what must not move stays where it came from
            estimates.append(updated(estimates[-1], fit, drift * np.outer(allowed, allowed)))
        latest, first = estimates[-1], estimates[min(1, len(estimates) - 1)]
    return latest, first


# How much strokes differ from each other, beside what the parameters explain.

# Of the information of a stroke in its best direction, that counts in another; chosen.
LEAST_INFORMATION = 0.03
# Bound of a standardised distance, mean of its square for normal errors; chosen, and by integration.
BOUND, BOUNDED_MEAN = 2.0, 0.9205
RATE, RANGE = 0.05, (0.2, 5.0)  # change of the log factor by a stroke, limits of the factor; chosen


def predicted_fit(fit: StrokeFit, predicted: Estimate) -> StrokeFit:
    """Return a fit of a stroke at what the strokes before predict, to first order."""
    gradient = fit.gradient - fit.information @ (predicted.mean - fit.at)
    return fit._replace(at=predicted.mean, gradient=gradient)


def speed_distance(fit: StrokeFit, predicted: Estimate, bounds: Bounds) -> float:
    """Return how much faster a stroke is than predicted, in standard deviations of stroke and prediction.

    With the curvature H and the covariance P of the prediction, the slope of the gain has the variance
    h + hᵀ P h, of the first row and the first element of H: what is not known of gain and dead zone apart may
    be known of the speed, which both give.
    """
    row = fit.information[0]
    covariance = predicted.covariance + np.diag(bounds.drift**2)
    variance = max(float(row[0] + row @ covariance @ row), np.finfo(float).tiny)
    return float(predicted_fit(fit, predicted).gradient[0] / np.sqrt(variance))


def scatter_after(factor: float, fit: StrokeFit, predicted: Estimate, bounds: Bounds) -> float:
    """Return the factor on the scatter after a stroke.

    In each direction that the stroke informs about, the square of its standardised distance from what
    was predicted has a mean of one; that of one bounded by ±2, which outliers hardly move, of 0.92.
    """
    free, scales = np.ix_(bounds.allowed, bounds.allowed), bounds.scatter[bounds.allowed]
    values, directions = np.linalg.eigh(fit.information[free] * np.outer(scales, scales))
    informed = values > LEAST_INFORMATION * values.max()
    slopes: Float[np.ndarray, " k"] = scales * predicted_fit(fit, predicted).gradient[bounds.allowed]
    distances = (directions.T @ slopes)[informed] / np.sqrt(values[informed])
    spread = (predicted.covariance + np.diag(bounds.drift**2))[free] / np.outer(scales, scales)
    variances = 1 + values[informed] * np.diag(directions.T @ spread @ directions)[informed]
    squares = np.minimum(distances**2 / variances, BOUND**2)
    return float(np.clip(factor * np.exp(RATE * (np.mean(squares) - BOUNDED_MEAN)), *RANGE))
