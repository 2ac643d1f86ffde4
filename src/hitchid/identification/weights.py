"""The weights of a network as named arrays, and a network with weights so named."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hitchid._support.checkpoints import Arrays

Network = TypeVar("Network")


def weights_of(network: object) -> Arrays:
    """Return every array of a network, `weights 0` and so on."""
    leaves = jax.tree.leaves(eqx.filter(network, eqx.is_array))
    return {f"weights {number}": np.asarray(leaf) for number, leaf in enumerate(leaves)}


def with_weights(network: Network, arrays: Arrays) -> Network:
    """Return a network with its arrays replaced by those of `weights_of` one like it."""
    weights, static = eqx.partition(network, eqx.is_array)
    leaves, structure = jax.tree.flatten(weights)
    new_leaves = [jnp.asarray(arrays[f"weights {number}"]) for number in range(len(leaves))]
    return eqx.combine(jax.tree.unflatten(structure, new_leaves), static)
