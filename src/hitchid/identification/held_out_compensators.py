"""Compensators for predictions trained without each fold of tests, for what is calibrated on the fold."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, PRNGKeyArray, PyTree

from hitchid.estimation.training import every_nth, optimiser, pad_to_batches
from hitchid.identification.cross_fitting import HeldOut
from hitchid.identification.phase2 import (
    MAX_STRETCHES,
    CompensatorConfig,
    Sequences,
    squared_error,
    untrained_compensator,
)
from hitchid.networks.lstm import Lstm
from hitchid.structures import Batch

Tree = TypeVar("Tree")


class CompensatorTraining(NamedTuple):
    """How the compensator for predictions of a channel was trained.

    Attributes:
        settings: size and optimiser.
        epochs: number of epochs after which its weights were kept.
        key: initial weights and shuffling.
    """

    settings: CompensatorConfig
    epochs: int
    key: PRNGKeyArray


def with_compensators(
    held_out: Sequence[HeldOut], batch: Batch, training: CompensatorTraining
) -> tuple[HeldOut, ...]:
    """Return the channels of all folds, each with a compensator for predictions trained without the fold.

    All are trained by one program, and for as many epochs as that of the channel, so that no further
    tests are needed to stop them: they then learn from as many tests as the channel's own.

    Args:
        held_out: benchmarks fitted without each fold.
        batch: all tests.
        training: how the compensator of the channel was trained.
    """
    settings, epochs, key = training
    compensators, sequences = [], []
    for number, (tests, channel) in enumerate(held_out):
        training_mask = batch.loss_mask & jnp.asarray(~tests)[:, None]
        compensator, fold_sequences = untrained_compensator(
            batch,
            channel.simulate_benchmark(batch),
            channel.load_filter,
            settings,
            jax.random.fold_in(key, number),
            training_mask,
        )
        compensators.append(compensator)
        sequences.append(pad_to_batches(every_nth(fold_sequences, MAX_STRETCHES), settings.adam.batch))
    stacked_networks = _stacked([compensator.network for compensator in compensators])
    stacked_sequences = _stacked(sequences)
    keys = jax.random.split(key, len(held_out))
    trained = _train(stacked_networks, stacked_sequences, settings, jnp.asarray(epochs), keys)
    return tuple(
        HeldOut(
            tests,
            replace(
                channel,
                compensator=eqx.tree_at(lambda tree: tree.network, compensator, _item(trained, number)),
            ),
        )
        for number, ((tests, channel), compensator) in enumerate(zip(held_out, compensators, strict=True))
    )


# By NumPy, as no shape must be compiled for that.
def _stacked(trees: Sequence[Tree]) -> Tree:
    return jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *trees)


def _item(stacked: Lstm, number: int) -> Lstm:
    return jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf)[number]), stacked)


@eqx.filter_jit
def _train(
    networks: Lstm, sequences: Sequences, settings: CompensatorConfig, epochs: Array, keys: Array
) -> Lstm:
    """Return networks trained on the stretches outside their folds: mean weights of the last half of epochs.

    At a constant learning rate weights vary from epoch to epoch; the mean removes this, as the choice of the
    best epoch does for the channel's own compensator.
    """
    adam, stretches = settings.adam, sequences.loss_mask.shape[1]
    counts = jnp.sum(jnp.any(sequences.loss_mask, axis=-1), axis=-1)
    batches = -(-jnp.max(counts) // adam.batch)
    descent = optimiser(adam.learning_rate, adam.epochs * (stretches // adam.batch))
    weights, fixed = eqx.partition(networks, eqx.is_inexact_array)

    def mean_square(weights: PyTree, data: Sequences) -> Array:
        squares, count = squared_error(eqx.combine(weights, fixed), data)
        return squares / jnp.maximum(count, 1)

    def train(weights: PyTree, data: Sequences, key: PRNGKeyArray) -> PyTree:
        is_held_out = ~jnp.any(data.loss_mask, axis=-1)

        def epoch(number: Array, carry: tuple) -> tuple:
            weights, state, mean = carry
            uniform = jax.random.uniform(jax.random.fold_in(key, number), (stretches,))
            order = jnp.argsort(uniform + is_held_out)  # stretches of the fold come last

            def step(index: Array, carry: tuple) -> tuple:
                weights, state = carry
                rows = jax.lax.dynamic_slice(order, (index * adam.batch,), (adam.batch,))
                batch = jax.tree.map(lambda array: array[rows], data)
                change, state = descent.update(jax.grad(mean_square)(weights, batch), state, weights)
                return optax.apply_updates(weights, change), state

            weights, state = jax.lax.fori_loop(0, batches, step, (weights, state))
            share = 1 / jnp.maximum(number + 1 - epochs // 2, 1)
            mean = jax.tree.map(lambda old, new: old + (share * (new - old)).astype(old.dtype), mean, weights)
            return weights, state, mean

        start = (weights, descent.init(weights), weights)
        return jax.lax.fori_loop(0, epochs, epoch, start)[2]

    # One after the other: XLA is slow at batched products of small matrices.
    trained = jax.lax.map(lambda fold: train(*fold), (weights, sequences, keys))
    return eqx.combine(trained, fixed)
