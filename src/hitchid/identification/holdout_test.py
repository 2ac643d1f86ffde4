"""Result of the test of the compensator for free run on tests held out from its training."""

from dataclasses import dataclass

import numpy as np

from hitchid._support.short_repr import short_repr

FEWEST_TESTS = 3  # two to fit to and one to judge on, in turn


@short_repr
@dataclass(frozen=True)
class HoldoutTest:
    """Free runs of tests held out, with and without the compensator for free run.

    Attributes:
        accepted: whether the compensator becomes part of the model.
        benchmark, compensated: free-run RMSE of each test while it was held out, in the displacement's unit,
            shape [T]; empty where there were too few tests to hold any out.
    """

    accepted: bool
    benchmark: np.ndarray
    compensated: np.ndarray

    @property
    def log_ratio(self) -> tuple[float, float]:
        """Mean over tests of ln(RMSE with/RMSE without), and its standard error."""
        ratios = np.log(self.compensated / self.benchmark)
        return float(ratios.mean()), float(ratios.std(ddof=1) / np.sqrt(ratios.size))

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if not self.benchmark.size:
            return f"no network correction in free run: cross-validation needs {FEWEST_TESTS} tests"
        benchmark_rmse, compensated_rmse = (
            float(np.sqrt(np.mean(errors**2))) for errors in (self.benchmark, self.compensated)
        )
        better = int(np.sum(self.compensated < self.benchmark))
        figures = (
            f"cross-validation RMSE {benchmark_rmse:.4g} without the network correction, "
            f"{compensated_rmse:.4g} with it"
        )
        outcome = "network correction" if self.accepted else "no network correction"
        return f"{outcome} in free run: {figures}, smaller in {better} of {self.benchmark.size} tests"
