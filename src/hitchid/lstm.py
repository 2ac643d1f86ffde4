"""The one recurrent network of the house: an LSTM with a single linear output, in single precision."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float32, PRNGKeyArray

SINGLE = jnp.float32


class Hidden(NamedTuple):
    """The LSTM's state, each of shape [..., H]."""

    output: Float32[Array, "*b h"]
    cell: Float32[Array, "*b h"]


class Lstm(eqx.Module):
    """LSTM of one layer and a linear output: everything in it is trained."""

    cell: eqx.nn.LSTMCell
    head: eqx.nn.Linear

    @classmethod
    def fresh(cls, key: PRNGKeyArray, inputs: int, hidden: int) -> "Lstm":
        """Return a network whose cell is drawn from ±1/√H and whose output is zero."""
        # Drawn on the host: a compiler takes longer over the generator than over the network.
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        bound = 1 / np.sqrt(hidden)

        def drawn(array: jax.ShapeDtypeStruct) -> Array:
            return jnp.asarray(rng.uniform(-bound, bound, array.shape), SINGLE)

        def zero(array: jax.ShapeDtypeStruct) -> Array:
            return jnp.asarray(np.zeros(array.shape), SINGLE)

        cell = eqx.filter_eval_shape(eqx.nn.LSTMCell, inputs, hidden, dtype=SINGLE, key=key)
        head = eqx.filter_eval_shape(eqx.nn.Linear, hidden, 1, dtype=SINGLE, key=key)
        return cls(jax.tree.map(drawn, cell), jax.tree.map(zero, head))

    def blank(self, shape: tuple[int, ...]) -> Hidden:
        """Return the LSTM's state before it has read anything."""
        zeros = jnp.zeros((*shape, self.cell.hidden_size), SINGLE)
        return Hidden(zeros, zeros)

    def read(self, hidden: Hidden, inputs: Float32[Array, "b i"]) -> Hidden:
        """Let the LSTM read one input vector for each of b sequences."""
        return Hidden(*jax.vmap(self.cell)(inputs, tuple(hidden)))

    def output(self, hidden: Hidden) -> Float32[Array, " b"]:
        """Return the network's output for each of b sequences."""
        return jax.vmap(self.head)(hidden.output)[:, 0]
