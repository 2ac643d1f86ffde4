"""Gate of the compensator for free run: its test on tests held out from its training."""

from dataclasses import dataclass, field

import numpy as np

from hitchid._support.short_repr import short_repr

FEWEST_TESTS = 3  # one each to train on, to stop the training, and to test on


@short_repr
@dataclass(frozen=True)
class HoldoutTest:
    """Result of the test of a compensator for free run on tests held out from its training.

    Attributes:
        accepted: whether the compensator becomes part of the model.
        benchmark, compensated: free-run RMSE of each test while it was held out, in the displacement's unit,
            shape [T]; empty where there were too few tests to hold any out.
        best_epochs: of each member, the epoch whose weights were kept; 0 is the untrained network.
        training, validation: loss of each member relative to the benchmark's, shape [E, M].
    """

    accepted: bool
    benchmark: np.ndarray
    compensated: np.ndarray
    best_epochs: tuple[int, ...] = ()
    training: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    validation: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if not self.benchmark.size:
            return f"no LSTM correction in free run: cross-validation needs {FEWEST_TESTS} tests"
        benchmark_rmse, compensated_rmse = (
            float(np.sqrt(np.mean(errors**2))) for errors in (self.benchmark, self.compensated)
        )
        better = int(np.sum(self.compensated < self.benchmark))
        figures = (
            f"cross-validation RMSE {benchmark_rmse:.4g} without the LSTM correction, "
            f"{compensated_rmse:.4g} with it"
        )
        outcome = "LSTM correction" if self.accepted else "no LSTM correction"
        return f"{outcome} in free run: {figures}, smaller in {better} of {self.benchmark.size} tests"


def deal_roles(tests: int, members: int) -> tuple[np.ndarray, np.ndarray]:
    """Return which member is tested on each test, and the roles of the tests for each member.

    Member i is tested on fold i; fold i + 1 stops its training, and the others train it.

    Args:
        tests: T, how many there are.
        members: M, folds and members of the ensemble.

    Returns:
        The fold of each test, shape [T], and whether a test trains, validates and tests a member, shape
        [3, M, T].
    """
    fold = np.arange(tests) % members
    is_test = np.stack([fold == member for member in range(members)])
    is_validation = np.roll(is_test, -1, axis=0)
    return fold, np.stack([~is_test & ~is_validation, is_validation, is_test])
