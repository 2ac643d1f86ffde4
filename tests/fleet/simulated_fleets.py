"""Fleets of machines with known parameters."""

from typing import NamedTuple

import numpy as np


class Fleet(NamedTuple):
    """True parameters [N, P], their estimates [N, P] and the covariances of the errors [N, P, P]."""

    truth: np.ndarray
    estimates: np.ndarray
    covariances: np.ndarray


def simulated_fleet(rng, machines, *, mean=(0.0,), between=((1.0,),), errors=(0.5, 1.5), correlation=0.0):
    """Return machines N(mean, between) whose standard errors are uniform between two numbers."""
    size = len(mean)
    truth = rng.multivariate_normal(mean, between, machines, method="svd")
    shape = np.full((size, size), correlation) + (1 - correlation) * np.eye(size)
    deviations = rng.uniform(*errors, (machines, size))
    covariances = deviations[:, :, None] * shape * deviations[:, None, :]
    noise = deviations * rng.multivariate_normal(np.zeros(size), shape, machines, method="svd")
    return Fleet(truth, truth + noise, covariances)


def binomial_tolerance(share, draws):
    """Return four standard deviations of a share in independent draws."""
    return 4 * np.sqrt(share * (1 - share) / draws)
