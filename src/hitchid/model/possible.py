"""Channels that might as well be the true one, and how far apart their free runs are."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hitchid.model.channel import Channel
from hitchid.structures import Batch
from hitchid.uncertainty import Alternative


def possible(channel: Channel, alternative: Alternative) -> Channel:
    """Return a channel with the benchmark of an alternative, and in free run with its network alone."""
    row = jnp.asarray(alternative.benchmark)
    found = eqx.tree_at(lambda each: each.benchmark, channel, channel.benchmark.of_row(row))
    if alternative.member is None or channel.speed_compensator is None:
        return found
    networks = channel.speed_compensator.networks
    # As many as before, all alike: their mean is the one, and no program is compiled anew.
    alone = jax.tree.map(
        lambda leaf: jnp.asarray(np.broadcast_to(np.asarray(leaf)[alternative.member], leaf.shape)), networks
    )
    return eqx.tree_at(lambda each: each.speed_compensator.networks, found, alone)


def spread(
    channel: Channel, alternatives: Sequence[Alternative], batch: Batch
) -> tuple[Float[np.ndarray, "t n"], Float[np.ndarray, "a t n"]]:
    """Return a channel's free run, and by how much those of its alternatives differ, times their weights.

    Args:
        channel: of the model.
        alternatives: what might as well be true.
        batch: tests.
    """
    simulated = np.asarray(channel.simulate(batch))
    others = [np.asarray(possible(channel, each).simulate(batch)) for each in alternatives]
    weights = np.array([each.weight for each in alternatives])
    return simulated, weights[:, None, None] * (np.stack(others) - simulated)
