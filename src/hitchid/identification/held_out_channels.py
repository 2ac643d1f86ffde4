"""Channels fitted without each fold of tests, for what is calibrated on held-out tests."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, PRNGKeyArray, PyTree

from hitchid.estimation.training import every_nth, optimiser, pad_to_batches
from hitchid.identification.cross_fitting import folds_of, positions_without_folds, with_position
from hitchid.identification.phase1 import Phase1
from hitchid.identification.phase2 import (
    MAX_STRETCHES,
    CompensatorConfig,
    Sequences,
    squared_error,
    untrained_compensator,
)
from hitchid.model import Channel, EnsembleMember
from hitchid.model.ensemble import perturbed_channel
from hitchid.networks.lstm import Lstm
from hitchid.networks.speed_compensator import SpeedCompensator
from hitchid.structures import Batch


class HeldOut(NamedTuple):
    """Tests, and the channel that was fitted without them.

    Attributes:
        tests: which tests are held out, shape [T].
        channel: benchmark and compensators fitted to the other tests.
    """

    tests: Bool[np.ndarray, " t"]
    channel: Channel


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


def held_out_channels(
    channel: Channel,
    phase1: Phase1,
    batch: Batch,
    training: CompensatorTraining | None,
    speed_compensators: Sequence[SpeedCompensator] | None = None,
) -> list[HeldOut]:
    """Return for each fold of tests the channel fitted without it.

    Benchmark and compensator for predictions are fitted to the other tests. The compensator is trained for as
    many epochs as that of the channel, so that no further tests are needed to stop it: it then learns from as
    many tests as the channel's own, and its errors are of the same size.

    Args:
        channel: the channel fitted to all tests.
        phase1: its benchmark.
        batch: all tests.
        training: of its compensator; None if it has none.
        speed_compensators: compensator for free run fitted without each fold; None for the network of the
            channel's that was trained without the fold.
    """
    folds = folds_of(batch.command.shape[0])
    channels = [
        with_position(channel, phase1, position) for position in positions_without_folds(phase1, folds)
    ]
    if training is not None and channel.compensator is not None:
        channels = _with_compensators(channels, folds, batch, training)
    if speed_compensators is None:
        channels = [_with_network(fold_channel, number) for number, fold_channel in enumerate(channels)]
    else:
        channels = [
            replace(fold_channel, speed_compensator=compensator)
            for fold_channel, compensator in zip(channels, speed_compensators, strict=True)
        ]
    return [HeldOut(fold, fold_channel) for fold, fold_channel in zip(folds, channels, strict=True)]


def _with_compensators(
    channels: Sequence[Channel],
    folds: Sequence[Bool[np.ndarray, " t"]],
    batch: Batch,
    training: CompensatorTraining,
) -> list[Channel]:
    """Return the channels with compensators trained on the tests outside their folds, all at once."""
    settings, epochs, key = training
    compensators, sequences = [], []
    for number, (channel, fold) in enumerate(zip(channels, folds, strict=True)):
        training_mask = batch.loss_mask & jnp.asarray(~fold)[:, None]
        compensator, fold_sequences = untrained_compensator(
            batch, channel.simulate_benchmark(batch), settings, jax.random.fold_in(key, number), training_mask
        )
        compensators.append(compensator)
        sequences.append(pad_to_batches(every_nth(fold_sequences, MAX_STRETCHES), settings.adam.batch))
    stacked_networks = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *(compensator.network for compensator in compensators)
    )
    stacked_sequences = jax.tree.map(lambda *leaves: jnp.stack(leaves), *sequences)
    keys = jax.random.split(key, len(channels))
    trained = _train(stacked_networks, stacked_sequences, settings, jnp.asarray(epochs), keys)
    return [
        replace(channel, compensator=eqx.tree_at(lambda tree: tree.network, compensator, network))
        for channel, compensator, network in zip(
            channels, compensators, (_item(trained, number) for number in range(len(channels))), strict=True
        )
    ]


def _with_network(channel: Channel, number: int) -> Channel:
    """Return a channel whose free run is corrected by one network of its ensemble alone."""
    parameters = tuple(map(float, channel.benchmark.parameter_vector))
    return perturbed_channel(channel, EnsembleMember(parameters, number))


def _item(stacked: Lstm, number: int) -> Lstm:
    return jax.tree.map(lambda leaf: leaf[number], stacked)


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

    return eqx.combine(jax.vmap(train)(weights, sequences, keys), fixed)
