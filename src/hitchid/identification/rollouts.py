"""Training on free runs: a compensator that hears itself, and the gate that decides whether it ships."""

from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from hitchid._support.checkpoints import DISABLED, Arrays, Checkpoints
from hitchid._support.metrics import proven_better
from hitchid.estimation.training import optimiser, weights_of, with_weights
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import OperatingRange
from hitchid.networks.speed_compensator import INPUTS, BlockInputs, SpeedCompensator, compute_block_inputs
from hitchid.structures import Batch

MEMBERS = 4
FEWEST_TESTS = 3
CURRICULUM = (32, 128)
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


@dataclass(frozen=True)
class HoldoutTest:
    """Whether the compensator for free run ships, and why.

    Attributes:
        accepted: whether it does.
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
        """Why, in words."""
        if not self.benchmark.size:
            return f"no compensator in free run: fewer than {FEWEST_TESTS} tests, too few to hold any out"
        benchmark_rmse, compensated_rmse = (
            float(np.sqrt(np.mean(errors**2))) for errors in (self.benchmark, self.compensated)
        )
        better = int(np.sum(self.compensated < self.benchmark))
        figures = f"{benchmark_rmse:.4g} → {compensated_rmse:.4g} on tests held out in turn"
        outcome = "a compensator" if self.accepted else "no compensator"
        return f"{outcome} in free run: {figures}, better on {better} of {self.benchmark.size}"


def train_on_rollouts(
    batch: Batch,
    benchmark: Float[Array, "t n"],
    operating_range: OperatingRange,
    settings: Rollouts,
    key: PRNGKeyArray,
    checkpoints: Checkpoints = DISABLED,
) -> tuple[SpeedCompensator | None, HoldoutTest]:
    """Train an ensemble on free runs and let it ship only if it is better on tests it has not seen.

    Tests are dealt to M folds. Member i is trained on all but two of them: one stops its training, the other
    judges it. All members are trained in one compiled program, first on sections that start at the measured
    displacement, then on whole tests from their start. The mean of the members ships if on the judged tests,
    each by the member that has not seen it, free run is better by 2 % in all and on two thirds of them.

    Args:
        batch: identification tests.
        benchmark: travel the benchmark gives for them, shape [T, N].
        operating_range: what they cover.
        settings: size and optimiser.
        key: initial weights.
        checkpoints: where the weights and the losses are kept and found again.

    Returns:
        The compensator, None where the gate stays shut, and the gate.
    """
    tests = batch.command.shape[0]
    if tests < FEWEST_TESTS:
        return None, HoldoutTest(False, np.zeros(0), np.zeros(0))
    block_size = -(-batch.command.shape[1] // MAX_BLOCKS)
    block_inputs = compute_block_inputs(benchmark, batch.command, batch.initial, batch.covariate, block_size)
    measured, loss_mask = batch.travel[:, ::block_size].T, batch.loss_mask[:, ::block_size].T
    members = min(MEMBERS, tests)
    keys = jax.random.split(key, members)
    initial_networks = [Lstm.init(member_key, INPUTS, settings.hidden) for member_key in keys]
    networks = jax.tree.map(lambda *leaves: jnp.stack(leaves), *initial_networks)
    compensator = SpeedCompensator(
        networks=networks,
        command_scale=jnp.asarray(float(jnp.abs(batch.command).max()) or 1.0),
        increment_scale=jnp.asarray(float(jnp.std(block_inputs.travel_increment)) or 1.0),
        operating_range=operating_range,
        sign=batch.sign,
        block_size=block_size,
    )
    fold = np.arange(tests) % members
    is_test = np.stack([fold == member for member in range(members)])
    is_validation = np.roll(is_test, -1, axis=0)
    roles = jnp.asarray(np.stack([~is_test & ~is_validation, is_validation, is_test]))

    def work() -> Arrays:
        trained, best_epochs, losses, errors = _train(
            compensator, block_inputs, measured, loss_mask, roles, settings
        )
        outputs = {"best_epochs": best_epochs, "losses": losses, "errors": errors}
        return {**weights_of(trained), **{name: np.asarray(array) for name, array in outputs.items()}}

    arrays = checkpoints.cached_arrays("free runs", work)
    losses = arrays["losses"]
    compensated_rmse = np.array([float(arrays["errors"][fold[test], test]) for test in range(tests)])
    residuals = jnp.where(
        loss_mask,
        jnp.cumsum(block_inputs.travel_increment, axis=0) - block_inputs.travel_increment - measured,
        0.0,
    )
    benchmark_rmse = np.sqrt(
        np.asarray(jnp.sum(residuals**2, axis=0) / jnp.maximum(jnp.sum(loss_mask, axis=0), 1))
    )
    holdout_test = HoldoutTest(
        accepted=proven_better(compensated_rmse, benchmark_rmse),
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
    compensator: SpeedCompensator,
    block_inputs: BlockInputs,
    measured: Float[Array, "b t"],
    loss_mask: Bool[Array, "b t"],
    roles: Bool[Array, "3 m t"],
    settings: Rollouts,
) -> tuple[Lstm, Array, Array, Array]:
    """Return each member's best weights, their epochs, losses [E, 2, M], and test errors by member [M, T]."""
    counts = jnp.maximum(jnp.sum(loss_mask, axis=0), 1)
    benchmark_error = jnp.where(
        loss_mask,
        jnp.cumsum(block_inputs.travel_increment, axis=0) - block_inputs.travel_increment - measured,
        0.0,
    )
    benchmark_mse = jnp.mean(jnp.sum(benchmark_error**2, axis=0) / counts)

    def by_test(weights: Lstm, anchor_interval: Array) -> Float[Array, " t"]:
        """Return the mean square error of each test for one member."""
        single = jax.tree.map(lambda leaf: leaf[None], eqx.combine(weights, fixed))
        travel, _ = compensator.rollout(
            single, block_inputs, measured=measured, anchor_interval=anchor_interval, fused=True
        )
        return jnp.sum(jnp.where(loss_mask, travel - measured, 0.0) ** 2, axis=0) / counts

    def loss(weights: Lstm, role: Array, anchor_interval: Array) -> tuple[Array, Array]:
        squares = by_test(weights, anchor_interval) / benchmark_mse
        mean = jnp.stack([jnp.sum(squares * mask) / jnp.maximum(jnp.sum(mask), 1) for mask in role[:2]])
        return mean[0], mean

    weights, fixed = eqx.partition(compensator.networks, eqx.is_inexact_array)
    adam = optimiser(settings.learning_rate, settings.epochs)
    stage_epochs, blocks = settings.epochs // 5, block_inputs.command.shape[0]
    epoch_numbers = jnp.arange(settings.epochs)
    stage = jnp.minimum(epoch_numbers // max(stage_epochs, 1), len(CURRICULUM))
    anchor_intervals = jnp.asarray([*CURRICULUM, blocks])[stage]
    gradients = jax.vmap(jax.grad(loss, has_aux=True), in_axes=(0, 1, None))

    def epoch(carry: tuple, element: tuple[Array, Array]) -> tuple[tuple, Array]:
        weights, state, best, best_loss, best_epoch = carry
        number, anchor_interval = element
        gradient, mean = gradients(weights, roles, anchor_interval)
        is_full_rollout = anchor_interval == blocks
        improved = is_full_rollout & (mean[:, 1] < best_loss)
        best_loss = jnp.where(improved, mean[:, 1], best_loss)
        best_epoch = jnp.where(improved, number, best_epoch)
        best = jax.tree.map(
            lambda new, old: jnp.where(improved.reshape(-1, *(1 for _ in new.shape[1:])), new, old),
            weights,
            best,
        )
        change, state = jax.vmap(adam.update)(gradient, state, weights)
        return (optax.apply_updates(weights, change), state, best, best_loss, best_epoch), mean.T

    members = roles.shape[1]
    initial_losses = jax.vmap(
        lambda weights, role: loss(weights, role, jnp.asarray(blocks))[1][1], in_axes=(0, 1)
    )
    initial_carry = (
        weights,
        jax.vmap(adam.init)(weights),
        weights,
        initial_losses(weights, roles),
        jnp.zeros(members, epoch_numbers.dtype),
    )
    (_, _, best, _, best_epoch), losses = jax.lax.scan(
        epoch, initial_carry, (epoch_numbers, anchor_intervals)
    )
    errors = jnp.sqrt(jax.vmap(by_test, in_axes=(0, None))(best, jnp.asarray(blocks)))
    return eqx.combine(best, fixed), best_epoch, jnp.sqrt(losses), errors
