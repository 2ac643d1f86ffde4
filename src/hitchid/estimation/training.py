"""Adam with early stopping: one compiled program an epoch."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from hitchid._support.checkpoints import DISABLED, Arrays, Checkpoints, Shapes
from hitchid._support.records import short_repr

Network = TypeVar("Network")
# Share of the learning rate at the end of the cosine, and largest norm of a gradient: common for an LSTM.
FINAL_RATE, MAX_GRADIENT = 0.1, 1.0
Data = TypeVar("Data")
EpochCallback = Callable[[int, float, float], None]
SquaredError = Callable[[Any, PyTree], tuple[Float[Array, ""], Float[Array, ""]]]


class TrainingStopReason(Enum):
    """Why a training stopped, with what to try."""

    PATIENCE = "the validation loss no longer improved"
    EPOCHS = "the maximum number of epochs was reached; more may improve the fit"
    FAILED = "the loss was not finite; lower the learning rate"


@dataclass(frozen=True)
class AdamConfig:
    """Settings of a training.

    Attributes:
        epochs: largest number of passes over the training data.
        patience: epochs without a better validation loss after which to stop.
        batch: sequences in one gradient step.
        learning_rate: Adam's, at the start; it falls to a tenth along a cosine.
    """

    epochs: int = 300
    patience: int = 40
    batch: int = 32
    learning_rate: float = 3e-3


@short_repr
@dataclass(frozen=True)
class TrainingHistory:
    """Both losses, an entry an epoch, root mean square in the scale of the target.

    Attributes:
        training, validation: losses, shape [E].
        best_epoch: the epoch whose weights were kept; 0 stands for the untrained network.
        stop_reason: why the training stopped.
    """

    training: np.ndarray
    validation: np.ndarray
    best_epoch: int
    stop_reason: TrainingStopReason


def train(
    network: Network,
    error: SquaredError,
    training: PyTree,
    validation: PyTree,
    settings: AdamConfig,
    key: PRNGKeyArray,
    progress: EpochCallback | None = None,
    checkpoints: Checkpoints = DISABLED,
) -> tuple[Network, TrainingHistory]:
    """Train a network and return the weights of the epoch with the smallest validation loss.

    The error is the sum of squared errors and their number: one function for trainings that are to share a
    compiled program. First axes run over sequences; those that fill no batch are left out in turn.
    """

    def work() -> Arrays:
        best, trace = _train(network, error, training, validation, settings, key, progress)
        final_fields = {
            "best_epoch": np.asarray(trace.best_epoch),
            "ending": np.asarray(list(TrainingStopReason).index(trace.stop_reason)),
        }
        return {
            **weights_of(best),
            "training": trace.training,
            "validation": trace.validation,
            **final_fields,
        }

    shapes = {"training": ("e",), "validation": ("e",), "best_epoch": int, "ending": int}
    arrays = checkpoints.cached_arrays("training", work, {**weight_shapes(network), **shapes})
    stop_reason = list(TrainingStopReason)[int(arrays["ending"]) % len(TrainingStopReason)]
    trace = TrainingHistory(arrays["training"], arrays["validation"], int(arrays["best_epoch"]), stop_reason)
    return with_weights(network, arrays), trace


def optimiser(learning_rate: float, steps: int) -> optax.GradientTransformation:
    """Return Adam with gradients clipped to norm 1; its rate falls to a tenth along a cosine."""
    schedule = optax.cosine_decay_schedule(learning_rate, steps, alpha=FINAL_RATE)
    return optax.chain(optax.clip_by_global_norm(MAX_GRADIENT), optax.adam(schedule))


def weights_of(network: object) -> Arrays:
    """Return every array of a network, `weights 0` and so on."""
    leaves = jax.tree.leaves(eqx.filter(network, eqx.is_array))
    return {f"weights {number}": np.asarray(leaf) for number, leaf in enumerate(leaves)}


def weight_shapes(network: object) -> Shapes:
    """Return the shapes of `weights_of`."""
    return {name: array.shape for name, array in weights_of(network).items()}


def with_weights(network: Network, arrays: Arrays) -> Network:
    """Return a network with its arrays replaced by those of `weights_of` one like it."""
    weights, static = eqx.partition(network, eqx.is_array)
    leaves, structure = jax.tree.flatten(weights)
    new_leaves = [jax.device_put(arrays[f"weights {number}"]) for number in range(len(leaves))]
    return eqx.combine(jax.tree.unflatten(structure, new_leaves), static)


def every_nth(data: Data, limit: int) -> Data:
    """Return every m-th sequence, so that no more than so many are left."""
    stride = -(-jax.tree.leaves(data)[0].shape[0] // limit)
    return jax.tree.map(lambda array: array[::stride], data)


def pad_to_batches(data: Data, batch: int) -> Data:
    """Return sequences and, to fill the last batch, such of zeros: data of like size share a program."""
    missing = -jax.tree.leaves(data)[0].shape[0] % batch

    def padded(array: Array) -> Array:
        # By NumPy, as no shape must be compiled for that.
        return jax.device_put(np.pad(np.asarray(array), ((0, missing), *((0, 0),) * (array.ndim - 1))))

    return jax.tree.map(padded, data)


def _train(
    network: Network,
    error: SquaredError,
    training: PyTree,
    validation: PyTree,
    settings: AdamConfig,
    key: PRNGKeyArray,
    progress: EpochCallback | None,
) -> tuple[Network, TrainingHistory]:
    sequences = jax.tree.leaves(training)[0].shape[0]
    batches = sequences // min(settings.batch, sequences)
    state = optimiser(settings.learning_rate, settings.epochs * batches).init(
        eqx.filter(network, eqx.is_inexact_array)
    )
    best = network
    best_loss = float(_loss(error, network, validation))
    best_epoch, stop_reason = 0, TrainingStopReason.EPOCHS
    training_losses, validation_losses = [], []
    for number in range(1, settings.epochs + 1):
        network, state, loss = _epoch(
            error, settings, network, state, training, jax.random.fold_in(key, number)
        )
        training_losses.append(float(loss))
        validation_losses.append(float(_loss(error, network, validation)))
        if progress is not None:
            progress(number, training_losses[-1], validation_losses[-1])
        if not np.isfinite(training_losses[-1]):
            stop_reason = TrainingStopReason.FAILED
            break
        if validation_losses[-1] < best_loss:
            best, best_loss, best_epoch = network, validation_losses[-1], number
        elif number - best_epoch >= settings.patience:
            stop_reason = TrainingStopReason.PATIENCE
            break
    return best, TrainingHistory(
        np.asarray(training_losses), np.asarray(validation_losses), best_epoch, stop_reason
    )


@eqx.filter_jit
def _loss(error: SquaredError, network: PyTree, data: PyTree) -> Float[Array, ""]:
    squares, count = error(network, data)
    return jnp.sqrt(squares / jnp.maximum(count, 1))


@eqx.filter_jit
def _epoch(
    error: SquaredError, settings: AdamConfig, network: PyTree, state: PyTree, data: PyTree, key: PRNGKeyArray
) -> tuple[PyTree, PyTree, Array]:
    """Return network and optimiser state after one pass, and the loss on the way."""
    sequences = jax.tree.leaves(data)[0].shape[0]
    batch = min(settings.batch, sequences)
    batches = sequences // batch
    adam = optimiser(settings.learning_rate, settings.epochs * batches)
    weights, fixed = eqx.partition(network, eqx.is_inexact_array)
    order = jax.random.permutation(key, sequences)[: batches * batch].reshape(batches, batch)

    def mean_square(weights: PyTree, rows: Array) -> tuple[Array, tuple[Array, Array]]:
        batch_data = jax.tree.map(lambda array: array[rows], data)
        squares, count = error(eqx.combine(weights, fixed), batch_data)
        return squares / jnp.maximum(count, 1), (squares, count)

    def step(carry: tuple, rows: Array) -> tuple[tuple, tuple[Array, Array]]:
        weights, state = carry
        (_, squared_errors), gradient = jax.value_and_grad(mean_square, has_aux=True)(weights, rows)
        change, state = adam.update(gradient, state, weights)
        return (optax.apply_updates(weights, change), state), squared_errors

    (weights, state), (squared_errors, counts) = jax.lax.scan(step, (weights, state), order)
    loss = jnp.sqrt(jnp.sum(squared_errors) / jnp.maximum(jnp.sum(counts), 1))
    return eqx.combine(weights, fixed), state, loss
