"""Parameters drawn from the distribution of their estimates."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid.model.estimates import Estimate, Estimates
from hitchid.structures import PhysicalModel

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch

PARAMETER_DRAWS = 200  # parameter vectors of a band by default; chosen
PROFILE_REACH = 1.5  # three standard deviations over the two of a 95 % interval


def draws_of(
    model: "Hitch", direction: str, seed: int, count: int = PARAMETER_DRAWS
) -> Float[np.ndarray, "s r"] | None:
    """Return parameter vectors of a direction; None where the model has no standard errors.

    Raises:
        InputError: the count is no whole number above zero, or the seed none of at least zero.
    """
    checks.integer(seed, "seed")
    checks.integer(count, "draws", minimum=1)
    uncertainty = model.uncertainty.get(direction)
    if uncertainty is None or not any(parameter.error for parameter in uncertainty.benchmark.parameters):
        return None
    return draw_parameters(model.channels[direction].benchmark, uncertainty.benchmark, count, seed)


def draw_parameters(
    benchmark: PhysicalModel, estimates: Estimates, count: int, seed: int
) -> Float[np.ndarray, "s r"]:
    """Return parameter vectors from the normal distribution of the estimates around the model's values.

    Positive parameters are drawn by their logarithm, as they are estimated. A parameter beyond the bounds of
    the search, or far beyond its likelihood profile, is set to that limit, and the others to their mean given
    that; one without a standard error keeps its value.
    """
    names = [parameter.name for parameter in benchmark.parameters]
    vectors = np.tile(np.asarray(benchmark.parameter_vector, dtype=np.float64), (count, 1))
    parameters = estimates.parameters
    columns = [names.index(estimate.name) for estimate in parameters]
    values = vectors[0, columns]
    linear = np.array([estimate.linear for estimate in parameters])
    # Of the logarithm of a positive parameter the standard error is the relative one.
    errors = np.array([estimate.error or 0.0 for estimate in parameters])
    deviations = errors / np.where(linear | (errors == 0), 1.0, values)
    covariance = np.outer(deviations, deviations) * np.array(estimates.correlation)
    random = np.random.default_rng(seed)
    # Singular where a parameter keeps its value, which the eigenvalue decomposition allows.
    steps = random.multivariate_normal(np.zeros(deviations.size), covariance, count, method="eigh")
    bounds = np.array([_bounds(estimate, value) for estimate, value in zip(parameters, values, strict=True)])
    for row, step in zip(vectors, steps, strict=True):
        within = _within(step, covariance, *bounds.T)
        row[columns] = np.where(linear, values + within, values * np.exp(np.where(linear, 0.0, within)))
    return vectors


def _within(
    step: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
    lowest: Float[np.ndarray, " p"],
    highest: Float[np.ndarray, " p"],
) -> Float[np.ndarray, " p"]:
    """Return a step with parameters at the bounds that it passes, the others at their mean given these.

    So what a bound takes from one parameter does not stay with those that it is correlated with. They are
    held one by one, first the one that is the most standard errors beyond its bound.
    """
    held = np.zeros(step.size, bool)
    deviations = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    while np.any(beyond := ~held & ((step < lowest) | (step > highest))):
        excess = np.abs(step - np.clip(step, lowest, highest)) / deviations
        held[np.argmax(np.where(beyond, excess, -1.0))] = True
        moved = (np.clip(step, lowest, highest) - step)[held]
        step = step + covariance[:, held] @ np.linalg.pinv(covariance[np.ix_(held, held)]) @ moved
        step[held] = np.clip(step, lowest, highest)[held]
    return step


def _bounds(estimate: Estimate, value: float) -> tuple[float, float]:
    """Return the largest steps of a parameter, or of its logarithm, down and up.

    They end at the bounds of the search, and at `PROFILE_REACH` times an interval of the likelihood profile:
    where the error of two parameters together is large, as of the frequency and the damping of an overdamped
    load, their normal distribution reaches far beyond what the tests allow.
    """

    def step(end: float) -> float:
        return end - value if estimate.linear else float(np.log(end / value))

    lower, upper = step(min(estimate.lower, value)), step(max(estimate.upper, value))
    if estimate.method == "profile":
        low, high = estimate.interval
        if low is not None and (estimate.linear or low > 0):
            lower = max(lower, PROFILE_REACH * min(step(low), 0.0))
        if high is not None:
            upper = min(upper, PROFILE_REACH * max(step(high), 0.0))
    return lower, upper
