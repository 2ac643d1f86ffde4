"""Training of an ensemble on free runs: full batch, all members in one compiled program."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float32, PyTree

from hitchid.baselines.integrating_lstm import IntegratingLstm
from hitchid.estimation.training import EpochCallback, optimiser

# Gradient steps between two looks at the validation tests, before the training may stop, and without a
# better validation error after which it stops; chosen.
STEPS_PER_LOOK, FEWEST_STEPS, PATIENCE_STEPS = 50, 1500, 500
LEARNING_RATE = 1e-2  # of Adam at the start; chosen
CHOOSING_MEMBERS = 2  # members that choose the number of steps for all; chosen, it bounds the time
# Blocks over which errors of increments count beside the error of the position. Errors of a free run add up:
# they grow as those of a random walk, and increments show where they come from.
INCREMENT_BLOCKS = (2, 8)


class Sections(NamedTuple):
    """Free runs of B tests in K blocks of M steps, scaled.

    Attributes:
        inputs: of the network, shape [K, B, I].
        start: position before motion, shape [B].
        position: measured position at the end of each step, shape [K, B, M].
        increment_scale: factor on the network's increments, shape [].
    """

    inputs: Float32[Array, "k b i"]
    start: Float32[Array, " b"]
    position: Float32[Array, "k b m"]
    increment_scale: Float32[Array, ""]


def train_ensemble(
    untrained: IntegratingLstm,
    sections: Sections,
    training: Float32[Array, "k b m"],
    validation: Float32[Array, "k b m"],
    everything: Float32[Array, "k b m"],
    steps: int,
    progress: EpochCallback | None = None,
) -> tuple[IntegratingLstm, int]:
    """Choose the number of gradient steps on validation tests, then train on all tests for as many.

    Args:
        untrained: the members, a leading axis over them in each array.
        sections: free runs of all tests.
        training, validation, everything: weights of the errors for the choice and for the final training.
        steps: largest number of gradient steps.
        progress: called at each look with the steps done, training and validation error.

    Returns:
        The ensemble, and the number of steps it was trained for: 0 where no training improved it.
    """
    networks = jax.tree.map(lambda array: array[:CHOOSING_MEMBERS], untrained)
    best_step, best_error = 0, float(_mean_error(networks, sections, validation))
    state = _initial_state(networks, steps)
    for step in range(STEPS_PER_LOOK, steps + 1, STEPS_PER_LOOK):
        networks, state = _advance(networks, state, sections, training, steps)
        error = float(_mean_error(networks, sections, validation))
        if progress is not None:
            progress(step, float(_mean_error(networks, sections, training)), error)
        if error < best_error:
            best_step, best_error = step, error
        elif step >= FEWEST_STEPS and step - best_step >= PATIENCE_STEPS:
            break
    networks, state = untrained, _initial_state(untrained, steps)
    for _ in range(0, best_step, STEPS_PER_LOOK):
        networks, state = _advance(networks, state, sections, everything, steps)
    return networks, best_step


@eqx.filter_jit
def _mean_error(networks: IntegratingLstm, sections: Sections, weight: Array) -> Array:
    """Return the root mean square error of the members' mean."""
    members = eqx.filter_vmap(IntegratingLstm.simulate, in_axes=(eqx.if_array(0), None, None, None))
    positions = members(networks, sections.inputs, sections.start, sections.increment_scale).mean(axis=0)
    return jnp.sqrt(_mean_square(positions - sections.position, weight))


@partial(jax.jit, static_argnums=1)
def _initial_state(networks: PyTree, steps: int) -> PyTree:
    return jax.vmap(optimiser(LEARNING_RATE, steps).init)(networks)


@partial(jax.jit, static_argnums=4)
def _advance(
    networks: PyTree, state: PyTree, sections: Sections, weight: Array, steps: int
) -> tuple[PyTree, PyTree]:
    """Return networks and optimiser states after the gradient steps up to the next look."""
    adam = optimiser(LEARNING_RATE, steps)
    travel = sections.position - sections.start[:, None]
    scale = jnp.maximum(_mean_square(travel, weight), jnp.finfo(travel.dtype).tiny)

    def loss(network: IntegratingLstm) -> Array:
        positions = network.simulate(sections.inputs, sections.start, sections.increment_scale)
        return _loss(positions - sections.position, weight) / scale

    def step(carry: tuple[PyTree, PyTree], _: None) -> tuple[tuple[PyTree, PyTree], None]:
        network, state = carry
        change, state = adam.update(jax.grad(loss)(network), state, network)
        return (optax.apply_updates(network, change), state), None

    def advance(network: PyTree, state: PyTree) -> tuple[PyTree, PyTree]:
        return jax.lax.scan(step, (network, state), None, length=STEPS_PER_LOOK)[0]

    return jax.vmap(advance)(networks, state)


def _loss(errors: Array, weight: Array) -> Array:
    """Return the mean square of the errors of position and, as of a random walk, of increments."""
    blocks = errors.shape[0]
    total = _mean_square(errors, weight)
    for lag in INCREMENT_BLOCKS:
        if 2 * lag < blocks:
            both = weight[lag:] * weight[:-lag]
            total += blocks / (2 * lag) * _mean_square(errors[lag:] - errors[:-lag], both)
    return total


def _mean_square(errors: Array, weight: Array) -> Array:
    return jnp.sum(weight * errors**2) / jnp.maximum(jnp.sum(weight), 1.0)
