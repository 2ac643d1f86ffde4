"""The error of a linear model over all tests from their correlations, collected once."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid.estimation.objective import Bounds, Objective, traced
from hitchid.estimation.search_problem import SearchProblem
from hitchid.structures import Batch, ModelSpec, Scales, pulse_response

MAX_SAMPLES = 4096  # of a test: R then has 128 MiB
MAX_SAMPLES_PER_TEST = 256  # samples a test for every test: with fewer tests simulating costs less


class Correlations(eqx.Module):
    """Correlations that give the squared error of a linear model at a cost that no number of tests raises.

    A model's travel is ŷ(n) = Σⱼ hⱼ u(n−j), with h its response to a command of one sample. With an
    integrator's h = κ as reference, e = y − κ Σ u its error, and δ = h − κ,

        J² = ⟨(y − ŷ)²⟩ = ⟨e²⟩ − 2 c·δ + δᵀ R δ,   cⱼ = ⟨e(n) u(n−j)⟩,   Rⱼₖ = ⟨u(n−j) u(n−k)⟩

    where ⟨·⟩ is the mean over the samples of a test that count and then over tests. Rounding of J² is that of
    ⟨e²⟩, which is why δ and not h stands there: an integrator leaves far less than the whole way.

    Attributes:
        gain: κ, shape [].
        error_power: ⟨e²⟩, shape [].
        cross_correlation: c, shape [N].
        auto_correlation: R, shape [N, N].
    """

    gain: Float[Array, ""]
    error_power: Float[Array, ""]
    cross_correlation: Float[Array, " n"]
    auto_correlation: Float[Array, "n n"]

    @classmethod
    def of(cls, batch: Batch) -> "Correlations":
        """Collect the correlations of tests; those without a sample that counts are left out.

        Args:
            batch: tests whose samples count up to some sample each; see `correlations_applicable`.
        """
        counts = np.asarray(batch.loss_mask).sum(axis=1)
        test_indices = np.flatnonzero(counts)
        mask = np.asarray(batch.loss_mask)[test_indices]
        weight = np.sqrt(1 / (test_indices.size * counts[test_indices, None]))
        command = weight * np.asarray(batch.command)[test_indices]
        travel = weight * np.where(mask, np.asarray(batch.travel)[test_indices], 0.0)
        command_sum = np.cumsum(np.pad(command, ((0, 0), (1, 0)))[:, :-1], axis=1)
        command_sum = np.where(mask, command_sum, 0.0)
        gain = float(np.sum(command_sum * travel) / np.sum(command_sum**2))
        error = travel - gain * command_sum
        # Tests end together, what counts of them: Rⱼₖ = Rⱼ₊₁,ₖ₊₁ + the product at the last sample.
        source = counts[test_indices, None] - 1 - np.arange(command.shape[1])
        rows = np.take_along_axis(command, np.maximum(source, 0), axis=1)
        # By JAX: threads of NumPy's library would wait, busily, on the cores that the search needs.
        products = np.array(_gram_matrix(jnp.asarray(np.where(source >= 0, rows, 0.0))))
        for row in range(len(products) - 2, -1, -1):
            products[row, :-1] += products[row + 1, 1:]
        return cls(
            gain=jnp.asarray(gain),
            error_power=jnp.asarray(np.sum(error**2)),
            cross_correlation=jnp.asarray(_cross_correlation(error, command)),
            auto_correlation=jnp.asarray(products),
        )

    def mean_square(self, response: Float[Array, "p n"]) -> Float[Array, " p"]:
        """Return J² of p models."""
        difference = (response - self.gain).at[:, 0].set(0.0)
        return jnp.maximum(
            self.error_power
            - 2 * difference @ self.cross_correlation
            + jnp.sum((difference @ self.auto_correlation) * difference, axis=1),
            0.0,
        )


def correlations_applicable(batch: Batch) -> bool:
    """Return whether correlations are defined for tests and cheaper than simulating them.

    The samples that count must be the first ones of each test. R has N² numbers: for a few long tests
    simulating them costs less.
    """
    loss_mask = np.asarray(batch.loss_mask)
    tests, samples = loss_mask.shape
    mask_is_prefix = bool(np.all(loss_mask[:, :-1] >= loss_mask[:, 1:]))
    return mask_is_prefix and samples <= min(MAX_SAMPLES, MAX_SAMPLES_PER_TEST * tests)


class CorrelationObjective(eqx.Module):
    """J of a linear model over tests, at the same cost for any number of them; see `Correlations`."""

    correlations: Correlations
    spec: ModelSpec = eqx.field(static=True)
    scales: Scales
    bounds: Bounds
    step_s: float

    def __call__(self, positions: Float[Array, "p d"]) -> Float[Array, " p"]:
        """Return J at each of p positions."""

        def response(position: Float[Array, " d"]) -> Float[Array, " n"]:
            benchmark = self.spec.physical_model(self.bounds.values(position), self.scales)
            return pulse_response(
                benchmark.discretised(self.step_s), self.correlations.cross_correlation.size
            )

        return jnp.sqrt(self.correlations.mean_square(jax.vmap(response)(positions)))


def search_problem(objective: Objective) -> SearchProblem:
    """Return the problem of a global search: by correlations where these are defined, else by simulation."""
    problem = objective.problem()
    spec, batch = objective.spec, objective.batch
    structure = spec.structure.linear
    curved = spec.nonlinearity_parameters or spec.covariates
    is_linear = structure is not None and not structure.has_dry_friction and not curved
    if not (is_linear and correlations_applicable(batch)):
        return problem
    correlations = Correlations.of(batch)
    fitness = CorrelationObjective(correlations, spec, objective.scales, objective.bounds, batch.step_s)
    return replace(problem, fitness=traced(fitness))


@jax.jit
def _gram_matrix(rows: Float[Array, "t n"]) -> Float[Array, "n n"]:
    return rows.T @ rows


def _cross_correlation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return Σ a(n) b(n − j) over all tests, for every j ≥ 0."""
    samples = first.shape[1]
    first_spectrum, second_spectrum = (np.fft.rfft(rows, 2 * samples) for rows in (first, second))
    return np.fft.irfft(np.sum(first_spectrum * second_spectrum.conj(), axis=0))[:samples]
