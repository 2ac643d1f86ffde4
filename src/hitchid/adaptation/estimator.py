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

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.stroke_errors import StrokeFit

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

    Args:
        fit: of a stroke.
        scatter: Σ, covariance of the changes from stroke to stroke.
    """
    inverse = np.linalg.inv(np.eye(3) + fit.information @ scatter)
    information = inverse @ fit.information
    return fit._replace(
        squares=float(fit.squares - fit.gradient @ scatter @ inverse @ fit.gradient),
        gradient=inverse @ fit.gradient,
        information=0.5 * (information + information.T),
    )


def updated(prior: Estimate, fit: StrokeFit, drift: Matrix) -> Estimate:
    """Return the estimate after one more stroke; its mean is clear of what the stroke does not tell.

    Args:
        prior: before it.
        fit: of the stroke, of any linearisation.
        drift: Q, covariance of the wandering from the stroke before.
    """
    predicted = prior.covariance + drift
    covariance = predicted @ np.linalg.inv(np.eye(3) + fit.information @ predicted)
    covariance = 0.5 * (covariance + covariance.T)
    mean = prior.mean + covariance @ (fit.gradient - fit.information @ (prior.mean - fit.at))
    return Estimate(mean, covariance)


def restricted(fit: StrokeFit, free: Bool[np.ndarray, "3"], held_at: Vector) -> StrokeFit:
    """Return a fit of which only some parameters are free, the others held at their values."""
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

    Args:
        estimate: of all parameters.
        free: which of them are.
        held_at: values of the others.
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

    The second is the arrival cost of the window without that stroke.

    Args:
        fits_at: fits of the window's strokes, the oldest first, at changes of the parameters.
        arrival: estimate before the window.
        drift: Q.
        allowed: parameters that may move.
    """
    latest = first = arrival
    for _ in range(ITERATIONS):
        estimates = [arrival]
        for fit in fits_at(latest.mean):
            fit = restricted(fit, allowed, arrival.mean)
            estimates.append(updated(estimates[-1], fit, drift * np.outer(allowed, allowed)))
        latest, first = estimates[-1], estimates[min(1, len(estimates) - 1)]
    return latest, first
