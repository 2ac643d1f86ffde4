"""A baseline for hitchid: constant speed while the command is beyond its dead zone."""

from collections.abc import Sequence

import numpy as np

from hitchid.baselines.baseline import Baseline, FitContext, FittedBaseline, Sizes
from hitchid.structures import Batch


class ConstantSpeed(FittedBaseline):
    """Displacement of a piston that moves at one speed or stands.

    Attributes:
        speed: the speed, displacement's unit/s, shape [].
    """

    speed: np.ndarray

    def free_run(self, batch: Batch) -> np.ndarray:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        return np.asarray(batch.initial)[:, None] + batch.sign * self.speed * moving_time_s(batch)

    def predict(self, batch: Batch, horizons: Sequence[int]) -> None:
        """Return nothing: no measured displacement is used."""


class ConstantSpeedBaseline(Baseline):
    """The speed by least squares on travel over moving time."""

    name, title = "constant_speed", "constant speed"

    def fit(self, tests: Batch, context: FitContext) -> ConstantSpeed:
        """Return the baseline whose free run is nearest to the tests."""
        loss_mask = np.asarray(tests.loss_mask)
        time_s, travel = moving_time_s(tests)[loss_mask], np.asarray(tests.travel)[loss_mask]
        return ConstantSpeed(np.array(time_s @ travel / (time_s @ time_s)))

    def skeleton(self, shapes: Sizes) -> ConstantSpeed:
        """Return a baseline to be filled with the stored speed."""
        return ConstantSpeed(np.zeros(()))


def moving_time_s(batch: Batch) -> np.ndarray:
    """Return for how long the command was beyond its dead zone before each sample, s, shape [T, N]."""
    is_moving = np.asarray(batch.command) > 0
    return batch.step_s * (np.cumsum(is_moving, axis=1) - is_moving)


BASELINE = ConstantSpeedBaseline()
