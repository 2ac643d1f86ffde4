"""Forward regression with orthogonal least squares (FROLS): candidate terms and their order."""

from itertools import combinations_with_replacement

import numpy as np

CONSTANT = 1001  # code of the first covariate among the factors of a term; the initial displacement is last
DEPENDENT = 1e-10  # share of a term's square that is left orthogonal to the others; below it is none


def candidate_terms(lags: int, constants: np.ndarray) -> np.ndarray:
    """Return all products of up to two factors; see `Narx`, shape [C, 2].

    Args:
        lags: largest lag.
        constants: covariates and initial displacement of the tests, scaled; one that does not vary is no
            factor.
    """
    lagged = range(1, lags + 1)
    varied = [CONSTANT + number for number, column in enumerate(constants.T) if np.ptp(column) > 0]
    factors = [0, *lagged, *(-i for i in lagged), *varied]
    return np.array(list(combinations_with_replacement(factors, 2)), dtype=np.int64)


def order_of_terms(rows: np.ndarray, target: np.ndarray, most: int) -> list[int]:
    """Return the terms in the order of their error reduction ratio, each orthogonal to those before.

    Args:
        rows: candidate terms at all samples, shape [K, C].
        target: what they explain, shape [K].
        most: number of terms to return; fewer where all others depend on them.

    Source: Chen, Billings and Luo, Orthogonal least squares methods (1989).
    """
    left, remaining = rows.copy(), target.copy()
    squares = np.sum(rows**2, axis=0)
    order: list[int] = []
    for _ in range(most):
        energies = np.sum(left**2, axis=0)
        usable = energies > DEPENDENT * squares
        usable[order] = False
        if not usable.any():
            break
        reductions = np.where(usable, (remaining @ left) ** 2 / np.where(usable, energies, 1.0), -1.0)
        selected = int(np.argmax(reductions))
        order.append(selected)
        direction = left[:, selected] / np.sqrt(energies[selected])
        left -= np.outer(direction, direction @ left)
        remaining -= direction * (direction @ remaining)
    return order
