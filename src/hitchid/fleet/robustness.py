"""Weights that bound the influence of outlying machines, and their constants at the normal distribution."""

from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.special import chdtr, chdtri, ndtr

CLIP = 2.0  # standard deviations beyond which a machine loses weight; chosen: 88 % efficient for the variance
INSIDE = float(
    2 * ndtr(CLIP) - 1
)  # share of a normal distribution within CLIP, for every number of parameters


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


PLAIN = NormalConstants(
    float(np.finfo(float).max), 1.0, 1.0, 1.0
)  # of plain REML, where no machine loses weight


@cache
def normal_constants(parameters: int = 1) -> NormalConstants:
    """Return the constants for vectors of some length, d² ~ χ²ₚ.

    The variance solves Σ min(d², c²)/κ = n p: its efficiency is 2 p F²/Var min(d², c²), F = P(χ²ₚ₊₂ < c²).
    The mean solves Σ w(d²) r = 0: its variance is p E[w² d²]/E[p w + 2 d² w′]² times that of the plain mean.

    Args:
        parameters: p, length of the vectors.

    Source: Huber 1981, Robust Statistics, proposal 2 and sec. 8 (M-estimates of a scatter matrix).
    """
    p = parameters
    clip = float(chdtri(p, 1 - INSIDE))
    inside, inside_2, inside_4 = (float(chdtr(p + more, clip)) for more in (0, 2, 4))
    outside = 1 - inside
    clipped = p * inside_2 + clip * outside
    variance = p * (p + 2) * inside_4 + clip**2 * outside - clipped**2
    inverse = _inverse_beyond(p, clip)
    squared_score = p * inside_2 + clip**2 * inverse
    slope = p * inside + (p - 2) * clip * inverse
    return NormalConstants(clip, clipped / p, 2 * p * inside_2**2 / variance, squared_score * p / slope**2)


def constants_of(parameters: int, *, robust: bool) -> NormalConstants:
    """Return the constants for vectors of some length; the plain ones if not robust, or without a length."""
    return normal_constants(parameters) if robust and parameters else PLAIN


def _inverse_beyond(parameters: int, clip: float) -> float:
    """Return E[1/d²; d² > c²] for d² ~ χ²ₚ."""
    from scipy.integrate import quad
    from scipy.stats import chi2

    return float(quad(lambda square: chi2.pdf(square, parameters) / square, clip, np.inf)[0])


def weights(squared: np.ndarray, clip: np.ndarray | float) -> np.ndarray:
    """Return min(1, c²/d²), of the shape of the squared distances."""
    return clip / np.maximum(squared, clip)
