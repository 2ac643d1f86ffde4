"""What tests say of the parameters, and what one more would: Fisher information with correlated errors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import toeplitz

from hitchid.estimation import Misfit
from hitchid.estimation.misfit import TIED
from hitchid.uncertainty.moves import Moves

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
    def of(cls, misfit: Misfit, position: np.ndarray, moved: Moves) -> "Information":
        """Gather what tests say at the best position.

        Args:
            misfit: identification tests and form.
            position: the estimates, shape [D].
            moved: by how much each test moves each estimate.
        """
        errors, test = misfit.errors(position)
        free = np.flatnonzero(np.any(moved.by_test != 0, axis=0))
        curvature = misfit.equations_by_test(position).curvatures.sum(axis=0)[np.ix_(free, free)]
        covariance = (moved.by_test.T @ moved.by_test)[np.ix_(free, free)]
        counts = np.bincount(test)
        every = max(1, int(counts.max()) // LAGS)
        fixed = np.outer(moved.by_dead_zone[free], moved.by_dead_zone[free])
        return cls(
            names=tuple(misfit.form.parameters[number].name for number in free),
            slopes=tuple(map(float, misfit.slopes(position)[free])),
            curvature=_rows(curvature),
            scatter=_rows(curvature @ covariance @ curvature),
            fixed=_rows(fixed),
            autocovariance=_autocovariance(errors, test, every),
            every=every,
            apart=misfit.apart,
            tests=int(np.count_nonzero(counts)),
            samples=float(counts[counts > 0].mean()),
        )

    def widths(self) -> Float[np.ndarray, " d"]:
        """Return the standard errors now, by place between bounds."""
        return self._widths(np.array(self.curvature), np.array(self.scatter))

    def widths_with_another(self) -> Float[np.ndarray, " d"]:
        """Return what one more test like those there were is expected to leave."""
        more = 1 + 1 / self.tests
        return self._widths(more * np.array(self.curvature), more * np.array(self.scatter))

    def heard(
        self, travel: Float[np.ndarray, " n"], jacobian: Float[np.ndarray, "n d"]
    ) -> Float[np.ndarray, "n d"]:
        """Return a test's derivatives as the fit hears them: without what its own speed would take up.

        J − ŷ (ŷᵀJ)/((1 + ρ) ŷᵀŷ), to first order where the test is fitted well; see `Misfit.residuals`.

        Args:
            travel: ŷ, of the model.
            jacobian: its derivative by the parameters' places between bounds.
        """
        if not self.apart:
            return jacobian
        return jacobian - np.outer(travel, travel @ jacobian / ((1 + TIED) * (travel @ travel)))

    def widths_with(self, jacobian: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " d"]:
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
        return self._widths(
            np.array(self.curvature) + share * jacobian.T @ jacobian,
            np.array(self.scatter) + share**2 * means.T @ covariance @ means,
        )

    def _widths(self, curvature: np.ndarray, scatter: np.ndarray) -> np.ndarray:
        inverse = np.linalg.pinv(curvature, hermitian=True)
        return np.sqrt(np.diag(inverse @ scatter @ inverse + np.array(self.fixed)))


def _autocovariance(errors: np.ndarray, test: np.ndarray, every: int) -> tuple[float, ...]:
    """Return the mean of eₖ eₖ₊ₗ over tests, a lag every so many samples; biased, so a covariance."""
    rows = np.split(errors, np.flatnonzero(np.diff(test)) + 1)
    whole = [row[: len(row) // every * every] for row in rows if len(row) >= every]
    blocks = [row.reshape(-1, every).mean(axis=1) for row in whole]
    longest = max(len(row) for row in blocks)
    sums = np.zeros(longest)
    for row in blocks:
        sums[: len(row)] += np.correlate(row, row, "full")[len(row) - 1 :]
    return tuple(map(float, sums / sum(len(row) for row in blocks)))


def _rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(map(float, row)) for row in matrix)
