"""Channels that might as well be the true one, and how far apart their free runs are."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hitchid.model.channel import Channel
from hitchid.structures import Batch
from hitchid.uncertainty import EnsembleMember


def perturbed_channel(channel: Channel, member: EnsembleMember) -> Channel:
    """Return a channel with the benchmark of an alternative, and in free run with its network alone."""
    row = jnp.asarray(member.benchmark)
    perturbed = eqx.tree_at(
        lambda tree: tree.benchmark, channel, channel.benchmark.with_parameter_vector(row)
    )
    if member.member is None or channel.speed_compensator is None:
        return perturbed
    networks = channel.speed_compensator.networks
    # As many as before, all alike: their mean is the one, and no program is compiled anew.
    repeated_network = jax.tree.map(
        lambda leaf: jnp.asarray(np.broadcast_to(np.asarray(leaf)[member.member], leaf.shape)), networks
    )
    return eqx.tree_at(lambda tree: tree.speed_compensator.networks, perturbed, repeated_network)


def ensemble_deviations(
    channel: Channel, members: Sequence[EnsembleMember], batch: Batch
) -> tuple[Float[np.ndarray, "t n"], Float[np.ndarray, "a t n"]]:
    """Return a channel's free run, and by how much those of its alternatives differ, times their weights.

    Args:
        channel: of the model.
        members: what might as well be true.
        batch: tests.
    """
    simulated = np.asarray(channel.simulate(batch))
    member_runs = [np.asarray(perturbed_channel(channel, member).simulate(batch)) for member in members]
    weights = np.array([member.weight for member in members])
    return simulated, weights[:, None, None] * (np.stack(member_runs) - simulated)
