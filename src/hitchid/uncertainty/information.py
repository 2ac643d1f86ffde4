"""What tests say of the parameters, and what one more would: Fisher information with correlated errors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import toeplitz

from hitchid.estimation import Objective
from hitchid.estimation.objective import GAIN_RIDGE
from hitchid.uncertainty.influence import Influence

LAGS = 100


@dataclass(frozen=True)
class Information:
    """What the identification tests say of the parameters that do not lie at a bound.

    Attributes:
        names: of these parameters.
        slopes: of each, by its place between the bounds of the search.
        curvature: H = Σ Jₜᵀ Jₜ by place between bounds.
        scatter: Σ of the tests' slopes squared, so that H⁻¹ · scatter · H⁻¹ is the estimates' covariance.
        fixed: what the error of the dead zone adds to that covariance, however many tests there are.
        autocovariance: of the errors, every so many samples.
        every: samples between two lags.
        apart: whether the fit left each test a speed of its own; what is known is then known beside that.
        tests, samples: how many tests there were, and samples in the mean one.
    """

    names: tuple[str, ...]
    slopes: tuple[float, ...]
    curvature: tuple[tuple[float, ...], ...]
    scatter: tuple[tuple[float, ...], ...]
    fixed: tuple[tuple[float, ...], ...]
    autocovariance: tuple[float, ...]
    every: int
    apart: bool
    tests: int
    samples: float

    @classmethod
    def of(cls, objective: Objective, position: np.ndarray, influence: Influence) -> "Information":
        """Gather what tests say at the best position.

        Args:
            objective: identification tests and form.
            position: the estimates, shape [D].
            influence: by how much each test moves each estimate.
        """
        errors, test = objective.errors(position)
        free = np.flatnonzero(np.any(influence.by_test != 0, axis=0))
        curvature = objective.equations_by_test(position).curvatures.sum(axis=0)[np.ix_(free, free)]
        covariance = (influence.by_test.T @ influence.by_test)[np.ix_(free, free)]
        counts = np.bincount(test)
        block_size = max(1, int(counts.max()) // LAGS)
        dead_zone_covariance = np.outer(influence.by_dead_zone[free], influence.by_dead_zone[free])
        return cls(
            names=tuple(objective.spec.parameters[number].name for number in free),
            slopes=tuple(map(float, objective.slopes(position)[free])),
            curvature=_rows(curvature),
            scatter=_rows(curvature @ covariance @ curvature),
            fixed=_rows(dead_zone_covariance),
            autocovariance=_autocovariance(errors, test, block_size),
            every=block_size,
            apart=objective.per_test_gain,
            tests=int(np.count_nonzero(counts)),
            samples=float(counts[counts > 0].mean()),
        )

    def standard_errors(self) -> Float[np.ndarray, " d"]:
        """Return the standard errors now, by place between bounds."""
        return self._standard_errors(np.array(self.curvature), np.array(self.scatter))

    def standard_errors_with_repeat(self) -> Float[np.ndarray, " d"]:
        """Return what one more test like those there were is expected to leave."""
        factor = 1 + 1 / self.tests
        return self._standard_errors(factor * np.array(self.curvature), factor * np.array(self.scatter))

    def profile_out_gain(
        self, travel: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n d"]
    ) -> Float[np.ndarray, "n d"]:
        """Return a test's derivatives as the fit hears them: without what its own speed would take up.

        J − ŷ (ŷᵀJ)/((1 + ρ) ŷᵀŷ), to first order where the test is fitted well; see `Objective.residuals`.

        Args:
            travel: ŷ, of the model.
            jacobian: its derivative by the parameters' places between bounds.
        """
        if not self.apart:
            return jacobian
        return jacobian - np.outer(travel, travel @ jacobian / ((1 + GAIN_RIDGE) * (travel @ travel)))

    def standard_errors_with(self, jacobian: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " d"]:
        """Return the standard errors that one more test is expected to leave, by place between bounds.

        V' = H'⁻¹ (Σ gₜ gₜᵀ + Jᵀ C J) H'⁻¹, H' = H + Jᵀ J, with C the errors' covariance as in the tests.
        A longer test weighs no more than a shorter one in the fit; what it brings is a better mean.

        Args:
            jacobian: derivative of travel by the parameters' places between bounds, shape [N, D].
        """
        samples = jacobian.shape[0]
        blocks = -(-samples // self.every)
        padded = np.pad(jacobian, ((0, blocks * self.every - samples), (0, 0)))
        means = padded.reshape(blocks, self.every, -1).sum(axis=1)
        covariance = toeplitz(np.resize(np.append(self.autocovariance, np.zeros(blocks)), blocks))
        share = self.samples / samples
        return self._standard_errors(
            np.array(self.curvature) + share * jacobian.T @ jacobian,
            np.array(self.scatter) + share**2 * means.T @ covariance @ means,
        )

    def _standard_errors(self, curvature: np.ndarray, score_covariance: np.ndarray) -> np.ndarray:
        inverse = np.linalg.pinv(curvature, hermitian=True)
        return np.sqrt(np.diag(inverse @ score_covariance @ inverse + np.array(self.fixed)))


def _autocovariance(errors: np.ndarray, test: np.ndarray, block_size: int) -> tuple[float, ...]:
    """Return the mean of eₖ eₖ₊ₗ over tests, a lag every so many samples; biased, so a covariance."""
    rows = np.split(errors, np.flatnonzero(np.diff(test)) + 1)
    trimmed = [row[: len(row) // block_size * block_size] for row in rows if len(row) >= block_size]
    blocks = [row.reshape(-1, block_size).mean(axis=1) for row in trimmed]
    longest = max(len(row) for row in blocks)
    sums = np.zeros(longest)
    for row in blocks:
        sums[: len(row)] += np.correlate(row, row, "full")[len(row) - 1 :]
    return tuple(map(float, sums / sum(len(row) for row in blocks)))


def _rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)
