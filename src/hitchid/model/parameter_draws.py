"""Parameters drawn from the distribution of their estimates."""

import numpy as np
from jaxtyping import Float

from hitchid.model.estimates import Estimate, Estimates
from hitchid.structures import PhysicalModel


def draw_parameters(
    benchmark: PhysicalModel, estimates: Estimates, count: int, seed: int
) -> Float[np.ndarray, "s r"]:
    """Return parameter vectors from the normal distribution of the estimates around the model's values.

    Positive parameters are drawn by their logarithm, as they are estimated. A draw beyond the bounds of the
    search is set to the bound; a parameter without a standard error keeps its value.

    Args:
        benchmark: the physical model.
        estimates: standard errors and correlation of its parameters.
        count: number of draws.
        seed: of the draws.

    Returns:
        Vectors as `PhysicalModel.parameter_vector` has them, shape [count, R].
    """
    names = [parameter.name for parameter in benchmark.parameters]
    vectors = np.tile(np.asarray(benchmark.parameter_vector, dtype=np.float64), (count, 1))
    parameters = estimates.parameters
    columns = [names.index(estimate.name) for estimate in parameters]
    deviations = np.array(
        [_deviation(estimate, vectors[0, i]) for estimate, i in zip(parameters, columns, strict=True)]
    )
    covariance = np.outer(deviations, deviations) * np.array(estimates.correlation)
    random = np.random.default_rng(seed)
    # Singular where a parameter keeps its value, which the eigenvalue decomposition allows.
    steps = random.multivariate_normal(np.zeros(deviations.size), covariance, count, method="eigh")
    for estimate, column, step in zip(parameters, columns, steps.T, strict=True):
        value = vectors[0, column]
        drawn = value + step if estimate.linear else value * np.exp(step)
        vectors[:, column] = np.clip(drawn, min(estimate.lower, value), max(estimate.upper, value))
    return vectors


def _deviation(estimate: Estimate, value: float) -> float:
    """Return the standard error of a parameter, or of its logarithm; zero where there is none."""
    if estimate.error is None:
        return 0.0
    return estimate.error if estimate.linear else estimate.error / value
