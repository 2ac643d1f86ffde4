"""Training of the compensator for free run on whole free runs, which feed its own predictions back."""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Arrays, Checkpoints
from hitchid._support.metrics import better_on_held_out_tests
from hitchid.estimation.training import optimiser, weights_of, with_weights
from hitchid.identification.holdout_test import FEWEST_TESTS, HoldoutTest, deal_roles
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import OperatingRange
from hitchid.networks.speed_compensator import INPUTS, BlockInputs, SpeedCompensator, compute_block_inputs
from hitchid.structures import Batch

MEMBERS = 4  # networks of the ensemble
CURRICULUM = (32, 128)  # blocks of the sections that the first two fifths of the epochs train on
# Largest number of blocks of a test, which bounds time and memory of backpropagation through a free run: at
# 10 ms tests up to 5 s have blocks of one sample.
MAX_BLOCKS = 512


@dataclass(frozen=True)
class Rollouts:
    """Settings of the training on free runs.

    Attributes:
        hidden: cells of each LSTM.
        epochs: passes over all tests; a fifth each on short and on longer sections, the rest on whole tests.
        learning_rate: Adam's, at the start; it falls to a tenth along a cosine.
    """

    hidden: int = 8
    epochs: int = 300
    learning_rate: float = 1e-2


class _FreeRuns(NamedTuple):
    """Tests in blocks.

    Attributes:
        inputs: of the compensator, from the benchmark's free run.
        measured: travel, shape [B, T].
        loss_mask: which blocks count, shape [B, T].
    """

    inputs: BlockInputs
    measured: Float[Array, "b t"]
    loss_mask: Bool[Array, "b t"]

    @property
    def counts(self) -> Array:
        """Blocks of each test that count, at least one, shape [T]."""
        return jnp.maximum(jnp.sum(self.loss_mask, axis=0), 1)

    def mean_squares(self, travel: Float[Array, "b t"]) -> Float[Array, " t"]:
        """Return the mean square error of each test."""
        return jnp.sum(jnp.where(self.loss_mask, travel - self.measured, 0.0) ** 2, axis=0) / self.counts

    @property
    def benchmark(self) -> Float[Array, " t"]:
        """The mean square error of the benchmark on each test."""
        increment = self.inputs.travel_increment
        return self.mean_squares(jnp.cumsum(increment, axis=0) - increment)


def train_on_rollouts(
    batch: Batch,
    benchmark: Float[Array, "t n"],
    operating_range: OperatingRange,
    settings: Rollouts,
    key: PRNGKeyArray,
    checkpoints: Checkpoints = DISABLED,
) -> tuple[SpeedCompensator | None, HoldoutTest]:
    """Train an ensemble on free runs and return it if it improves tests held out from its training.

    Tests are dealt to M folds, see `deal_roles`. All members are trained in one compiled program, first on
    sections that start at the measured displacement, then on whole tests from their start. The mean of the
    members is accepted if the free runs of tests, each by the member that was not trained on it, are better
    by 2 % in all and on two thirds of them.

    Args:
        batch: identification tests.
        benchmark: travel the benchmark gives for them, shape [T, N].
        operating_range: what they cover.
        settings: size and optimiser.
        key: initial weights.
        checkpoints: where the weights and the losses are kept and read back.

    Returns:
        The compensator, None where it was not accepted, and the result of the test.
    """
    tests = batch.command.shape[0]
    if tests < FEWEST_TESTS:
        return None, HoldoutTest(False, np.zeros(0), np.zeros(0))
    block_size = -(-batch.command.shape[1] // MAX_BLOCKS)
    inputs = compute_block_inputs(benchmark, batch.command, batch.initial, batch.covariate, block_size)
    runs = _FreeRuns(inputs, batch.travel[:, ::block_size].T, batch.loss_mask[:, ::block_size].T)
    members = min(MEMBERS, tests)
    keys = jax.random.split(key, members)
    initial_networks = [Lstm.init(member_key, INPUTS, settings.hidden) for member_key in keys]
    networks = jax.tree.map(lambda *leaves: jnp.stack(leaves), *initial_networks)
    compensator = SpeedCompensator(
        networks=networks,
        command_scale=jnp.asarray(float(jnp.abs(batch.command).max()) or 1.0),
        increment_scale=jnp.asarray(float(jnp.std(inputs.travel_increment)) or 1.0),
        operating_range=operating_range,
        sign=batch.sign,
        block_size=block_size,
    )
    fold, roles = deal_roles(tests, members)

    def work() -> Arrays:
        trained, best_epochs, losses, errors = _train(compensator, runs, jnp.asarray(roles), settings)
        outputs = {"best_epochs": best_epochs, "losses": losses, "errors": errors}
        return {**weights_of(trained), **{name: np.asarray(array) for name, array in outputs.items()}}

    arrays = checkpoints.cached_arrays("free runs", work)
    losses = arrays["losses"]
    compensated_rmse = np.array([float(arrays["errors"][fold[test], test]) for test in range(tests)])
    benchmark_rmse = np.sqrt(np.asarray(runs.benchmark))
    holdout_test = HoldoutTest(
        accepted=better_on_held_out_tests(compensated_rmse, benchmark_rmse),
        benchmark=benchmark_rmse,
        compensated=compensated_rmse,
        best_epochs=tuple(int(epoch) for epoch in arrays["best_epochs"]),
        training=losses[:, 0],
        validation=losses[:, 1],
    )
    if not holdout_test.accepted:
        return None, holdout_test
    return eqx.tree_at(lambda tree: tree.networks, compensator, with_weights(networks, arrays)), holdout_test


@eqx.filter_jit
def _train(
    compensator: SpeedCompensator, runs: _FreeRuns, roles: Bool[Array, "3 m t"], settings: Rollouts
) -> tuple[Lstm, Array, Array, Array]:
    """Return each member's best weights, their epochs, losses [E, 2, M], and test errors by member [M, T]."""
    benchmark_mse = jnp.mean(runs.benchmark)
    weights, fixed = eqx.partition(compensator.networks, eqx.is_inexact_array)

    def by_test(weights: Lstm, anchor_interval: Array) -> Float[Array, " t"]:
        """Return the mean square error of each test for one member."""
        single = jax.tree.map(lambda leaf: leaf[None], eqx.combine(weights, fixed))
        travel, _ = compensator.rollout(
            single, runs.inputs, measured=runs.measured, anchor_interval=anchor_interval, fused=True
        )
        return runs.mean_squares(travel)

    def loss(weights: Lstm, role: Array, anchor_interval: Array) -> tuple[Array, Array]:
        squares = by_test(weights, anchor_interval) / benchmark_mse
        mean = jnp.stack([jnp.sum(squares * mask) / jnp.maximum(jnp.sum(mask), 1) for mask in role[:2]])
        return mean[0], mean

    adam = optimiser(settings.learning_rate, settings.epochs)
    blocks, epoch_numbers = runs.inputs.command.shape[0], jnp.arange(settings.epochs)
    stage = jnp.minimum(epoch_numbers // max(settings.epochs // 5, 1), len(CURRICULUM))
    anchor_intervals = jnp.asarray([*CURRICULUM, blocks])[stage]
    gradients = jax.vmap(jax.grad(loss, has_aux=True), in_axes=(0, 1, None))

    def epoch(carry: tuple, element: tuple[Array, Array]) -> tuple[tuple, Array]:
        weights, state, best, best_loss, best_epoch = carry
        number, anchor_interval = element
        gradient, mean = gradients(weights, roles, anchor_interval)
        improved = (anchor_interval == blocks) & (mean[:, 1] < best_loss)
        best = _where_improved(improved, weights, best)
        change, state = jax.vmap(adam.update)(gradient, state, weights)
        best_loss = jnp.where(improved, mean[:, 1], best_loss)
        best_epoch = jnp.where(improved, number, best_epoch)
        return (optax.apply_updates(weights, change), state, best, best_loss, best_epoch), mean.T

    initial_loss = jax.vmap(
        lambda weights, role: loss(weights, role, jnp.asarray(blocks))[1][1], in_axes=(0, 1)
    )(weights, roles)
    no_epochs = jnp.zeros(roles.shape[1], epoch_numbers.dtype)
    initial_carry = (weights, jax.vmap(adam.init)(weights), weights, initial_loss, no_epochs)
    (_, _, best, _, best_epoch), losses = jax.lax.scan(
        epoch, initial_carry, (epoch_numbers, anchor_intervals)
    )
    errors = jnp.sqrt(jax.vmap(by_test, in_axes=(0, None))(best, jnp.asarray(blocks)))
    return eqx.combine(best, fixed), best_epoch, jnp.sqrt(losses), errors


def _where_improved(improved: Bool[Array, " m"], new: Lstm, old: Lstm) -> Lstm:
    """Return the new weights of the members that improved, and the old ones of the others."""

    def select(new_leaf: Array, old_leaf: Array) -> Array:
        return jnp.where(improved.reshape(-1, *(1 for _ in new_leaf.shape[1:])), new_leaf, old_leaf)

    return jax.tree.map(select, new, old)
