"""A black-box LSTM from commands to speed."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.networks.lstm import SINGLE, Lstm


class BlackBox(eqx.Module):
    """LSTM from commands to speed, integrated: no physics but that displacement is the sum of its changes.

    w(k) = σ Σ_{i<k} f(u(0) … u(i), x(0)), simulated from the start of a test.

    Attributes:
        network: the LSTM, reading command and initial displacement.
        command_scale: largest command of training, shape [].
        initial_centre, initial_scale: scaling of the initial displacement, shape [].
        change: σ, typical change of displacement in one sample, shape [].
    """

    network: Lstm
    command_scale: Float[Array, ""]
    initial_centre: Float[Array, ""]
    initial_scale: Float[Array, ""]
    change: Float[Array, ""]

    def inputs(self, command: Float[Array, "t n"], initial: Float[Array, " t"]) -> Float[Array, "t n 2"]:
        """Return the scaled inputs, shape [T, N, 2]."""
        scaled_initial = (initial - self.initial_centre) / self.initial_scale
        broadcast_initial = jnp.broadcast_to(scaled_initial[:, None], command.shape)
        return jnp.stack([command / self.command_scale, broadcast_initial], axis=-1).astype(SINGLE)

    def free_run(self, command: Float[Array, "t n"], initial: Float[Array, " t"]) -> Float[Array, "t n"]:
        """Return travel simulated from commands and initial displacement, shape [T, N]."""
        changes = speeds(self.network, self.inputs(command, initial))
        return self.change * accumulated(changes)


def speeds(network: Lstm, inputs: Float[Array, "t n i"]) -> Float[Array, "t n"]:
    """Return the network's output at every sample of every test, shape [T, N]."""
    rows = jnp.swapaxes(inputs, 0, 1)
    return network.unroll(rows, jnp.ones(rows.shape[:2], bool)).T


def accumulated(changes: Float[Array, "t n"]) -> Float[Array, "t n"]:
    """Return the sum of all changes before each sample, shape [T, N]."""
    return jnp.cumsum(changes, axis=1) - changes
