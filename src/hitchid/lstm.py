"""The one recurrent network of the house: an LSTM with a single linear output, in single precision."""

from typing import NamedTuple, cast

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

    def read(self, hidden: Hidden, inputs: Float32[Array, "*b i"]) -> Hidden:
        """Let the LSTM read one input vector for each sequence of any shape [b]."""
        cell = self.cell
        # Products of whole matrices: mapped over sequences the cell's own would be many small ones.
        heard = inputs @ cell.weight_ih.T + hidden.output @ cell.weight_hh.T + cast(Array, cell.bias)
        entry, kept, fresh, exit_ = jnp.split(heard, 4, axis=-1)
        memory = jax.nn.sigmoid(kept) * hidden.cell + jax.nn.sigmoid(entry) * jnp.tanh(fresh)
        return Hidden(jax.nn.sigmoid(exit_) * jnp.tanh(memory), memory)

    def output(self, hidden: Hidden) -> Float32[Array, "*b"]:
        """Return the network's output for each sequence."""
        return hidden.output @ self.head.weight[0] + cast(Array, self.head.bias)[0]
