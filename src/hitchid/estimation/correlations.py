"""The error of a linear model over all tests from their correlations, collected once."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.structures import Batch

LONGEST = 4096
PER_TEST = 256


class Correlations(eqx.Module):
    """What the squared error of every linear model depends on: an evaluation costs the same for any tests.

    A model's travel is ŷ(n) = Σⱼ hⱼ u(n−j), with h its response to a command of one sample. With an
    integrator's h = κ as reference, e = y − κ Σ u what that one misses, and δ = h − κ,

        J² = ⟨(y − ŷ)²⟩ = ⟨e²⟩ − 2 c·δ + δᵀ R δ,   cⱼ = ⟨e(n) u(n−j)⟩,   Rⱼₖ = ⟨u(n−j) u(n−k)⟩

    where ⟨·⟩ is the mean over the samples of a test that count and then over tests. Rounding of J² is that of
    ⟨e²⟩, which is why δ and not h stands there: an integrator leaves far less than the whole way.

    Attributes:
        gain: κ, shape [].
        missed: ⟨e²⟩, shape [].
        cross: c, shape [N].
        auto: R, shape [N, N].
    """

    gain: Float[Array, ""]
    missed: Float[Array, ""]
    cross: Float[Array, " n"]
    auto: Float[Array, "n n"]

    @classmethod
    def of(cls, batch: Batch) -> "Correlations":
        """Collect the correlations of tests; those without a sample that counts say nothing.

        Args:
            batch: tests whose samples count up to some sample each; see `collectable`.
        """
        counts = np.asarray(batch.counted).sum(axis=1)
        told = np.flatnonzero(counts)
        command, travel = np.asarray(batch.command)[told], np.asarray(batch.travel)[told]
        weight = np.sqrt(1 / (told.size * counts[told, None]))
        command, travel = weight * command, weight * np.where(np.asarray(batch.counted)[told], travel, 0.0)
        reached = np.cumsum(np.pad(command, ((0, 0), (1, 0)))[:, :-1], axis=1)
        reached = np.where(np.asarray(batch.counted)[told], reached, 0.0)
        gain = float(np.sum(reached * travel) / np.sum(reached**2))
        error = travel - gain * reached
        # Tests end together, what counts of them: Rⱼₖ = Rⱼ₊₁,ₖ₊₁ + the product at the last sample.
        late = _ending_together(command, counts[told])
        return cls(
            gain=jnp.asarray(gain),
            missed=jnp.asarray(np.sum(error**2)),
            cross=jnp.asarray(_correlated(error, command)),
            # By JAX: threads of NumPy's library would wait, busily, on the cores that the search needs.
            auto=jnp.asarray(_summed_along_diagonals(np.array(_products(jnp.asarray(late))))),
        )

    def mean_square(self, response: Float[Array, "p n"]) -> Float[Array, " p"]:
        """Return J² of p models.

        Args:
            response: h, their travel after a command of one for one sample, shape [P, N].
        """
        apart = (response - self.gain).at[:, 0].set(0.0)
        return jnp.maximum(
            self.missed - 2 * apart @ self.cross + jnp.sum((apart @ self.auto) * apart, axis=1), 0.0
        )


def collectable(batch: Batch) -> bool:
    """Tell whether correlations are defined for tests and cheaper than simulating them.

    The samples that count must be the first ones of each test. R has N² numbers: for a few long tests
    simulating them costs less.
    """
    counted = np.asarray(batch.counted)
    tests, samples = counted.shape
    first_ones = bool(np.all(counted[:, :-1] >= counted[:, 1:]))
    return first_ones and samples <= min(LONGEST, PER_TEST * tests)


@jax.jit
def _products(rows: Float[Array, "t n"]) -> Float[Array, "n n"]:
    return rows.T @ rows


def _correlated(ones: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return Σ a(n) b(n − j) over all tests, for every j ≥ 0."""
    samples = ones.shape[1]
    one, other = (np.fft.rfft(rows, 2 * samples) for rows in (ones, others))
    return np.fft.irfft(np.sum(one * other.conj(), axis=0))[:samples]


def _ending_together(rows: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return rows backwards from the last sample that counts, zero beyond their first."""
    back = counts[:, None] - 1 - np.arange(rows.shape[1])
    return np.where(back >= 0, np.take_along_axis(rows, np.maximum(back, 0), axis=1), 0.0)


def _summed_along_diagonals(matrix: np.ndarray) -> np.ndarray:
    """Return Σₘ M(j+m, k+m) at every j, k."""
    for row in range(len(matrix) - 2, -1, -1):
        matrix[row, :-1] += matrix[row + 1, 1:]
    return matrix
