"""Cross-fitting: the benchmark fitted to the tests of all folds but one, for each fold in turn."""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hitchid.errors import FitError
from hitchid.estimation import refine_subset
from hitchid.identification.phase1 import Phase1, with_calibrated_gain
from hitchid.model import Channel

FOLDS = 4  # every fourth test is held out together; chosen
STEPS = 10  # least-squares positions of a refit, which starts at the optimum over all tests; chosen


def folds_of(tests: int) -> list[Bool[np.ndarray, " t"]]:
    """Return which tests each fold holds out: every fourth; with fewer tests each is a fold."""
    fold = np.arange(tests) % min(FOLDS, tests)
    return [fold == number for number in np.unique(fold)]


def positions_without_folds(
    phase1: Phase1, folds: Sequence[Bool[np.ndarray, " t"]]
) -> list[Float[np.ndarray, " d"]]:
    """Return the parameters of the benchmark refitted without each fold, in the unit cube.

    A fold without which the refit fails keeps the parameters of all tests.

    Args:
        phase1: the benchmark's fit to all tests.
        folds: tests of each fold.
    """
    return [_refitted(phase1, held_out) for held_out in folds]


def with_position(channel: Channel, phase1: Phase1, position: np.ndarray) -> Channel:
    """Return a channel with other parameters of the benchmark; its gain calibration stays."""
    objective = phase1.fit.objective
    benchmark = objective.spec.physical_model(jnp.asarray(objective.values(position)), objective.scales)
    if objective.spec.structure.gain:
        benchmark = benchmark.with_gain(float(channel.benchmark.gain) / phase1.fit.gain)
    return replace(channel, benchmark=benchmark)


def _refitted(phase1: Phase1, held_out: np.ndarray) -> np.ndarray:
    objective, position = phase1.fit.objective, phase1.fit.position
    loss_mask = jnp.asarray(np.broadcast_to(~held_out[:, None], objective.batch.loss_mask.shape))
    training = objective.with_data(objective.batch.masked(loss_mask))
    free = np.flatnonzero(phase1.influence.free).tolist()
    if not free or held_out.all():
        return position
    refitted = position.copy()
    try:
        refitted[free] = refine_subset(training, free, [position], STEPS).position
    except FitError:
        return position
    return with_calibrated_gain(training, refitted)
