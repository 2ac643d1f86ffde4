"""Training on free runs: a compensator that hears itself, and the gate that decides whether it ships."""

from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from hitchid._support.checkpoints import NOWHERE, Arrays, Checkpoints
from hitchid._support.metrics import proven_better
from hitchid.identification.weights import weights_of, with_weights
from hitchid.networks.lstm import Lstm
from hitchid.networks.operating_range import Envelope
from hitchid.networks.speed_compensator import INPUTS, Drive, SpeedCompensator, driven_by
from hitchid.structures import Batch

MEMBERS = 4
FEWEST_TESTS = 3
CURRICULUM = (32, 128)
BLOCKS = 512


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
class Gate:
    """Whether the compensator for free run ships, and why.

    Attributes:
        open: whether it does.
        benchmark, compensated: free-run RMSE of each test while it was held out, in the displacement's unit,
            shape [T]; empty where there were too few tests to hold any out.
        best_epochs: of each member, the epoch whose weights were kept; 0 is the untrained network.
        training, validation: loss of each member relative to the benchmark's, shape [E, M].
    """

    open: bool
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
        before, after = (float(np.sqrt(np.mean(e**2))) for e in (self.benchmark, self.compensated))
        better = int(np.sum(self.compensated < self.benchmark))
        figures = f"{before:.4g} → {after:.4g} on tests held out in turn"
        kept = "a compensator" if self.open else "no compensator"
        return f"{kept} in free run: {figures}, better on {better} of {self.benchmark.size}"


def train_on_rollouts(
    batch: Batch,
    benchmark: Float[Array, "t n"],
    envelope: Envelope,
    settings: Rollouts,
    key: PRNGKeyArray,
    kept: Checkpoints = NOWHERE,
) -> tuple[SpeedCompensator | None, Gate]:
    """Train an ensemble on free runs and let it ship only if it is better on tests it has not seen.

    Tests are dealt to M folds. Member i is trained on all but two of them: one stops its training, the other
    judges it. All members are trained in one compiled program, first on sections that start at the measured
    displacement, then on whole tests from their start. The mean of the members ships if on the judged tests,
    each by the member that has not seen it, free run is better by 2 % in all and on two thirds of them.

    Args:
        batch: identification tests.
        benchmark: travel the benchmark gives for them, shape [T, N].
        envelope: what they cover.
        settings: size and optimiser.
        key: initial weights.
        kept: where the weights and the losses are kept and found again.

    Returns:
        The compensator, None where the gate stays shut, and the gate.
    """
    tests = batch.command.shape[0]
    if tests < FEWEST_TESTS:
        return None, Gate(False, np.zeros(0), np.zeros(0))
    every = -(-batch.command.shape[1] // BLOCKS)
    drive = driven_by(benchmark, batch.command, batch.initial, batch.load, every)
    measured, counted = batch.travel[:, ::every].T, batch.counted[:, ::every].T
    members = min(MEMBERS, tests)
    keys = jax.random.split(key, members)
    fresh = [Lstm.fresh(each, INPUTS, settings.hidden) for each in keys]
    networks = jax.tree.map(lambda *leaves: jnp.stack(leaves), *fresh)
    compensator = SpeedCompensator(
        networks=networks,
        command=jnp.asarray(float(jnp.abs(batch.command).max()) or 1.0),
        moved=jnp.asarray(float(jnp.std(drive.moved)) or 1.0),
        envelope=envelope,
        direction=batch.direction,
        every=every,
    )
    fold = np.arange(tests) % members
    judged = np.stack([fold == member for member in range(members)])
    stopping = np.roll(judged, -1, axis=0)
    roles = jnp.asarray(np.stack([~judged & ~stopping, stopping, judged]))

    def work() -> Arrays:
        trained, best_epochs, losses, errors = _train(compensator, drive, measured, counted, roles, settings)
        told = {"best_epochs": best_epochs, "losses": losses, "errors": errors}
        return {**weights_of(trained), **{name: np.asarray(array) for name, array in told.items()}}

    found = kept.arrays("free runs", work)
    losses = found["losses"]
    after = np.array([float(found["errors"][fold[test], test]) for test in range(tests)])
    misses = jnp.where(counted, jnp.cumsum(drive.moved, axis=0) - drive.moved - measured, 0.0)
    before = np.sqrt(np.asarray(jnp.sum(misses**2, axis=0) / jnp.maximum(jnp.sum(counted, axis=0), 1)))
    gate = Gate(
        open=proven_better(after, before),
        benchmark=before,
        compensated=after,
        best_epochs=tuple(int(epoch) for epoch in found["best_epochs"]),
        training=losses[:, 0],
        validation=losses[:, 1],
    )
    if not gate.open:
        return None, gate
    return eqx.tree_at(lambda c: c.networks, compensator, with_weights(networks, found)), gate


@eqx.filter_jit
def _train(
    compensator: SpeedCompensator,
    drive: Drive,
    measured: Float[Array, "b t"],
    counted: Bool[Array, "b t"],
    roles: Bool[Array, "3 m t"],
    settings: Rollouts,
) -> tuple[Lstm, Array, Array, Array]:
    """Return each member's best weights, their epochs, losses [E, 2, M], and test errors by member [M, T]."""
    counts = jnp.maximum(jnp.sum(counted, axis=0), 1)
    alone = jnp.where(counted, jnp.cumsum(drive.moved, axis=0) - drive.moved - measured, 0.0)
    size = jnp.mean(jnp.sum(alone**2, axis=0) / counts)

    def by_test(weights: Lstm, anchored_every: Array) -> Float[Array, " t"]:
        """Return the mean square error of each test for one member."""
        single = jax.tree.map(lambda leaf: leaf[None], eqx.combine(weights, fixed))
        travel, _ = compensator.rollout(
            single, drive, measured=measured, anchored_every=anchored_every, joined=True
        )
        return jnp.sum(jnp.where(counted, travel - measured, 0.0) ** 2, axis=0) / counts

    def loss(weights: Lstm, role: Array, anchored_every: Array) -> tuple[Array, Array]:
        squares = by_test(weights, anchored_every) / size
        mean = jnp.stack([jnp.sum(squares * part) / jnp.maximum(jnp.sum(part), 1) for part in role[:2]])
        return mean[0], mean

    weights, fixed = eqx.partition(compensator.networks, eqx.is_inexact_array)
    schedule = optax.cosine_decay_schedule(settings.learning_rate, settings.epochs, alpha=0.1)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    fifth, blocks = settings.epochs // 5, drive.command.shape[0]
    numbers = jnp.arange(settings.epochs)
    stage = jnp.minimum(numbers // max(fifth, 1), len(CURRICULUM))
    anchors = jnp.asarray([*CURRICULUM, blocks])[stage]
    slopes = jax.vmap(jax.grad(loss, has_aux=True), in_axes=(0, 1, None))

    def epoch(carry: tuple, given: tuple[Array, Array]) -> tuple[tuple, Array]:
        weights, state, best, least, best_epoch = carry
        number, anchored_every = given
        slope, mean = slopes(weights, roles, anchored_every)
        whole = anchored_every == blocks
        improved = whole & (mean[:, 1] < least)
        least = jnp.where(improved, mean[:, 1], least)
        best_epoch = jnp.where(improved, number, best_epoch)
        best = jax.tree.map(
            lambda new, old: jnp.where(improved.reshape(-1, *(1 for _ in new.shape[1:])), new, old),
            weights,
            best,
        )
        change, state = jax.vmap(optimiser.update)(slope, state, weights)
        return (optax.apply_updates(weights, change), state, best, least, best_epoch), mean.T

    members = roles.shape[1]
    untrained = jax.vmap(lambda weights, role: loss(weights, role, jnp.asarray(blocks))[1][1], in_axes=(0, 1))
    start = (
        weights,
        jax.vmap(optimiser.init)(weights),
        weights,
        untrained(weights, roles),
        jnp.zeros(members, numbers.dtype),
    )
    (_, _, best, _, best_epoch), losses = jax.lax.scan(epoch, start, (numbers, anchors))
    errors = jnp.sqrt(jax.vmap(by_test, in_axes=(0, None))(best, jnp.asarray(blocks)))
    return eqx.combine(best, fixed), best_epoch, jnp.sqrt(losses), errors
