"""How much strokes differ from each other, beside what the parameters explain."""

import numpy as np
from jaxtyping import Float

from hitchid.adaptation.bounds import Bounds
from hitchid.adaptation.estimator import Estimate
from hitchid.adaptation.stroke_errors import StrokeFit

LEAST_INFORMATION = (
    0.03  # of the information of a stroke in its best direction, that counts in another; chosen
)
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

    Args:
        factor: before it.
        fit: of the stroke, with the scatter of that factor.
        predicted: from the strokes before.
        bounds: of the channel.
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
