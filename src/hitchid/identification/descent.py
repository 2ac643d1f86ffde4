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

from hitchid._support.checkpoints import NOWHERE, Arrays, Checkpoints
from hitchid.identification.weights import weights_of, with_weights

Network = TypeVar("Network")
Data = TypeVar("Data")
Progress = Callable[[int, float, float], None]
SquaredError = Callable[[Any, PyTree], tuple[Float[Array, ""], Float[Array, ""]]]


class Ending(Enum):
    """Why a training stopped, with what to try."""

    PATIENCE = "the validation loss no longer improved"
    EPOCHS = "all epochs were run; more of them may still improve the fit"
    FAILED = "the loss was not finite; lower the learning rate"


@dataclass(frozen=True)
class Descent:
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


@dataclass(frozen=True)
class DescentTrace:
    """Both losses, an entry an epoch, root mean square in the scale of the target.

    Attributes:
        training, validation: losses, shape [E].
        best_epoch: the epoch whose weights were kept; 0 stands for the untrained network.
        ending: why the training stopped.
    """

    training: np.ndarray
    validation: np.ndarray
    best_epoch: int
    ending: Ending


def descend(
    network: Network,
    error: SquaredError,
    training: PyTree,
    validation: PyTree,
    settings: Descent,
    key: PRNGKeyArray,
    progress: Progress | None = None,
    kept: Checkpoints = NOWHERE,
) -> tuple[Network, DescentTrace]:
    """Train a network and return the weights of the epoch with the smallest validation loss.

    Args:
        network: what to train; all its floating-point arrays are.
        error: from network and data to the sum of squared errors and the number of them; one function for
            trainings that are to share a compiled program.
        training, validation: arrays whose first axis runs over sequences; of the training's, those that fill
            no batch are left out in turn, see `filled`.
        settings: epochs, patience, batch, learning rate.
        key: shuffles the sequences.
        progress: called after each epoch with its number, training and validation loss.
        kept: where the weights and the losses are kept and found again.
    """

    def work() -> Arrays:
        best, trace = _descend(network, error, training, validation, settings, key, progress)
        ending = {"best_epoch": np.asarray(trace.best_epoch), "ending": np.asarray(trace.ending.name)}
        return {**weights_of(best), "training": trace.training, "validation": trace.validation, **ending}

    found = kept.arrays("training", work)
    ending = Ending[str(found["ending"])]
    trace = DescentTrace(found["training"], found["validation"], int(found["best_epoch"]), ending)
    return with_weights(network, found), trace


def evenly(data: Data, most: int) -> Data:
    """Return every m-th sequence, so that no more than so many are left."""
    every = -(-jax.tree.leaves(data)[0].shape[0] // most)
    return jax.tree.map(lambda array: array[::every], data)


def filled(data: Data, batch: int) -> Data:
    """Return sequences and, to fill the last batch, such of zeros: data of like size share a program."""
    missing = -jax.tree.leaves(data)[0].shape[0] % batch
    return jax.tree.map(lambda array: jnp.pad(array, ((0, missing), *((0, 0),) * (array.ndim - 1))), data)


def _descend(
    network: Network,
    error: SquaredError,
    training: PyTree,
    validation: PyTree,
    settings: Descent,
    key: PRNGKeyArray,
    progress: Progress | None,
) -> tuple[Network, DescentTrace]:
    sequences = jax.tree.leaves(training)[0].shape[0]
    batches = sequences // min(settings.batch, sequences)
    state = _optimiser(settings, batches).init(eqx.filter(network, eqx.is_inexact_array))
    best = network
    best_loss = float(_loss(error, network, validation))
    best_epoch, ending = 0, Ending.EPOCHS
    trained, validated = [], []
    for number in range(1, settings.epochs + 1):
        network, state, loss = _epoch(
            error, settings, network, state, training, jax.random.fold_in(key, number)
        )
        trained.append(float(loss))
        validated.append(float(_loss(error, network, validation)))
        if progress is not None:
            progress(number, trained[-1], validated[-1])
        if not np.isfinite(trained[-1]):
            ending = Ending.FAILED
            break
        if validated[-1] < best_loss:
            best, best_loss, best_epoch = network, validated[-1], number
        elif number - best_epoch >= settings.patience:
            ending = Ending.PATIENCE
            break
    return best, DescentTrace(np.asarray(trained), np.asarray(validated), best_epoch, ending)


def _optimiser(settings: Descent, batches: int) -> optax.GradientTransformation:
    schedule = optax.cosine_decay_schedule(settings.learning_rate, settings.epochs * batches, alpha=0.1)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))


@eqx.filter_jit
def _loss(error: SquaredError, network: PyTree, data: PyTree) -> Float[Array, ""]:
    squares, count = error(network, data)
    return jnp.sqrt(squares / jnp.maximum(count, 1))


@eqx.filter_jit
def _epoch(
    error: SquaredError, settings: Descent, network: PyTree, state: PyTree, data: PyTree, key: PRNGKeyArray
) -> tuple[PyTree, PyTree, Array]:
    """Return network and optimiser state after one pass, and the loss on the way."""
    sequences = jax.tree.leaves(data)[0].shape[0]
    batch = min(settings.batch, sequences)
    batches = sequences // batch
    optimiser = _optimiser(settings, batches)
    weights, fixed = eqx.partition(network, eqx.is_inexact_array)
    order = jax.random.permutation(key, sequences)[: batches * batch].reshape(batches, batch)

    def mean_square(weights: PyTree, rows: Array) -> tuple[Array, tuple[Array, Array]]:
        chosen = jax.tree.map(lambda array: array[rows], data)
        squares, count = error(eqx.combine(weights, fixed), chosen)
        return squares / jnp.maximum(count, 1), (squares, count)

    def step(carry: tuple, rows: Array) -> tuple[tuple, tuple[Array, Array]]:
        weights, state = carry
        (_, missed), slope = jax.value_and_grad(mean_square, has_aux=True)(weights, rows)
        change, state = optimiser.update(slope, state, weights)
        return (optax.apply_updates(weights, change), state), missed

    (weights, state), (squares, counts) = jax.lax.scan(step, (weights, state), order)
    loss = jnp.sqrt(jnp.sum(squares) / jnp.maximum(jnp.sum(counts), 1))
    return eqx.combine(weights, fixed), state, loss
