"""Test for two modes: one shared linear model against one for each direction."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from scipy.special import fdtrc

from hitchid._support.metrics import proven_better
from hitchid.estimation import Objective, refine
from hitchid.identification.preparation import ChannelData
from hitchid.model import TwoModes
from hitchid.structures import Batch, ModelSpec, structure_named

SPEC = ModelSpec(structure_named("integrator-first-order"), dead_time=True)
# Positions of gain, time constant and dead time between their bounds; time constants of 0.1, 0.01 and 3 s.
STARTS = ((0.5, 0.4, 0.5), (0.5, 0.2, 0.5), (0.5, 0.7, 0.2))
FOLDS = 4  # every fourth test of a direction is held out together
STEPS, REFIT_STEPS = 40, 10  # positions of least squares, over all tests and without a fold
SAMPLES = 1024  # largest number of samples of a test
SIGNIFICANT = 0.01  # largest p-value of the F statistic


def compare_modes(channel_data: Mapping[str, ChannelData]) -> TwoModes | None:
    """Compare one linear model for both directions with one for each, in free run.

    K/(s (τ s + 1)) with a dead time, from effective command to travel. Every fourth test of each direction is
    held out in turn. The statistic is that of nested models, with tests in place of samples, for samples of
    one test err alike:

        F = ((S₁ − S₂)/p) / (S₂/(T − 2 p)),  S = Σ over tests of the mean square error

    with S₁ shared and S₂ of two models, p parameters a model, and T tests. Two modes are needed where
    held-out tests prove two models better and F is significant at 1 %.

    Args:
        channel_data: direction to its tests.

    Returns:
        The comparison; None where there is one direction only, or too few tests.
    """
    if len(channel_data) < 2:
        return None
    batch, direction_index = _pool_directions(
        [data.all_tests.decimate(SAMPLES) for data in channel_data.values()]
    )
    parameters = len(SPEC.parameters)
    degrees_of_freedom = direction_index.size - 2 * parameters
    if degrees_of_freedom < 1 or min(np.bincount(direction_index)) < FOLDS:
        return None
    objective = Objective.of(batch, SPEC)
    groups = {
        "shared": [np.ones(direction_index.size, bool)],
        "two": [direction_index == index for index in np.unique(direction_index)],
    }
    fold_index = np.concatenate(
        [np.arange(np.sum(direction_index == index)) % FOLDS for index in np.unique(direction_index)]
    )
    errors: dict[str, np.ndarray] = {}
    held_out: dict[str, np.ndarray] = {}
    for name, members in groups.items():
        errors[name], held_out[name] = np.zeros(direction_index.size), np.zeros(direction_index.size)
        for tests in members:
            best = min(
                (_fit(objective, tests, np.array(start), STEPS) for start in STARTS),
                key=lambda position: float(np.sum(objective.rmse_by_test(position)[tests] ** 2)),
            )
            errors[name][tests] = objective.rmse_by_test(best)[tests]
            for number in range(FOLDS):
                held_tests = tests & (fold_index == number)
                refitted = _fit(objective, tests & ~held_tests, best, REFIT_STEPS)
                held_out[name][held_tests] = objective.rmse_by_test(refitted)[held_tests]
    shared, two = (float(np.sum(errors[name] ** 2)) for name in ("shared", "two"))
    statistic = max(shared - two, 0.0) / parameters / (two / degrees_of_freedom)
    p_value = float(fdtrc(parameters, degrees_of_freedom, statistic))
    return TwoModes(
        needed=proven_better(held_out["two"], held_out["shared"]) and p_value < SIGNIFICANT,
        shared_rmse=float(np.sqrt(np.mean(held_out["shared"] ** 2))),
        two_rmse=float(np.sqrt(np.mean(held_out["two"] ** 2))),
        f_statistic=statistic,
        p_value=p_value,
        tests=int(direction_index.size),
    )


def _pool_directions(batches: list[Batch]) -> tuple[Batch, np.ndarray]:
    """Return the tests of both directions as travel from zero, and the direction index of each test."""
    width = max(batch.command.shape[1] for batch in batches)

    def pad_and_stack(name: str) -> jnp.ndarray:
        rows = [np.asarray(getattr(batch, name)) for batch in batches]
        return jnp.asarray(np.concatenate([np.pad(r, ((0, 0), (0, width - r.shape[1]))) for r in rows]))

    direction_index = np.repeat(np.arange(len(batches)), [batch.command.shape[0] for batch in batches])
    zeros = jnp.zeros(direction_index.size)
    return Batch(
        command=pad_and_stack("command"),
        raw_command=pad_and_stack("raw_command"),
        dead_zone=jnp.concatenate([batch.dead_zone for batch in batches]),
        displacement=pad_and_stack("travel"),
        valid=pad_and_stack("valid"),
        loss_mask=pad_and_stack("loss_mask"),
        initial=zeros,
        covariate=zeros,
        step_s=batches[0].step_s,
        sign=1,
    ), direction_index


def _fit(objective: Objective, tests: np.ndarray, start: np.ndarray, limit: int) -> np.ndarray:
    """Return the least-squares position over some tests; shapes stay the same, so nothing recompiles."""
    loss_mask = jnp.asarray(np.broadcast_to(tests[:, None], objective.batch.loss_mask.shape))
    problem = objective.with_data(objective.batch.masked(loss_mask)).problem()
    return refine(problem, start, limit=limit).position
