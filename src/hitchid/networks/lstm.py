"""The one recurrent network of the house: an LSTM with a single linear output, in single precision."""

from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float32, PRNGKeyArray

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

    def read(self, hidden: Hidden, inputs: Float32[Array, "*b i"], *, joined: bool = False) -> Hidden:
        """Let the LSTM read one input vector for each sequence of any shape [b].

        Args:
            hidden: its state.
            inputs: what is read.
            joined: whether one product serves inputs and state: its derivative takes a third less time, but
                how it rounds depends on the program around it more than how two do.
        """
        cell = self.cell
        # Products of whole matrices: mapped over sequences the cell's own would be many small ones.
        if joined:
            rows = jnp.concatenate([inputs, hidden.output], axis=-1)
            heard = rows @ jnp.concatenate([cell.weight_ih, cell.weight_hh], axis=1).T
        else:
            heard = inputs @ cell.weight_ih.T + hidden.output @ cell.weight_hh.T
        heard = heard + cast(Array, cell.bias)
        entry, kept, fresh, exit_ = jnp.split(heard, 4, axis=-1)
        memory = jax.nn.sigmoid(kept) * hidden.cell + jax.nn.sigmoid(entry) * jnp.tanh(fresh)
        return Hidden(jax.nn.sigmoid(exit_) * jnp.tanh(memory), memory)

    def output(self, hidden: Hidden) -> Float32[Array, "*b"]:
        """Return the network's output for each sequence."""
        return self._said(hidden.output)

    def outputs(self, inputs: Float32[Array, "n b i"], exist: Bool[Array, "n b"]) -> Float32[Array, "n b"]:
        """Return the network's output after each of N inputs to B sequences, from a blank state.

        What `read` and `output` give input by input, in less time, its derivative too. An input that does not
        exist leaves the state as it was.
        """
        weights = Weights(self.cell.weight_ih, self.cell.weight_hh, cast(Array, self.cell.bias))
        return self._said(_heard(weights, inputs, exist))

    def _said(self, heard: Float32[Array, "*b h"]) -> Float32[Array, "*b"]:
        return heard @ self.head.weight[0] + cast(Array, self.head.bias)[0]


class Weights(NamedTuple):
    """What the gates are made of: W_ih, shape [4 H, I], W_hh, shape [4 H, H], and b, shape [4 H]."""

    inputs: Float32[Array, "g i"]
    fed_back: Float32[Array, "g h"]
    bias: Float32[Array, " g"]


class Reading(NamedTuple):
    """What is kept of a reading for its derivative.

    Attributes:
        gates: tanh of entry/2, kept/2, fresh and exit/2, shape [N, B, 4 H].
        after: the state after each input, shape [N, B, H].
    """

    gates: Float32[Array, "n b g"]
    after: Hidden


@jax.custom_vjp
def _heard(weights: Weights, inputs: Array, exist: Array) -> Float32[Array, "n b h"]:
    """Return the LSTM's output after each input.

    All that needs no state is computed for all inputs at once, before the loop over them or after it, in the
    derivative as well. There the loop gives the derivatives by the gates, and those by the weights are one
    product over all inputs, which JAX's own derivative of the loop would add up input by input.
    """
    return _read(weights, inputs, exist).after.output


def _read(weights: Weights, inputs: Array, exist: Array) -> Reading:
    halves = _halves(weights)
    driven = inputs @ (weights.inputs.T * halves) + weights.bias * halves
    fed_back = weights.fed_back.T * halves

    def advance(before: Hidden, given: tuple[Array, Array]) -> tuple[Hidden, Reading]:
        driven, exists = given
        # σ(x) = ½ + ½ tanh(x/2): one function for all four.
        gates = jnp.tanh(driven + before.output @ fed_back)
        entry, kept, fresh, exit_ = jnp.split(gates, 4, axis=-1)
        cell = 0.5 * ((1 + kept) * before.cell + (1 + entry) * fresh)
        cell = jnp.where(exists, cell, before.cell)
        output = jnp.where(exists, 0.5 * (1 + exit_) * jnp.tanh(cell), before.output)
        after = Hidden(output, cell)
        return after, Reading(gates, after)

    zeros = jnp.zeros((inputs.shape[1], weights.fed_back.shape[1]), SINGLE)
    return jax.lax.scan(advance, Hidden(zeros, zeros), (driven, exist[..., None]))[1]


def _reading(weights: Weights, inputs: Array, exist: Array) -> tuple[Array, tuple]:
    reading = _read(weights, inputs, exist)
    return reading.after.output, (weights, inputs, exist, reading)


def _slopes(kept: tuple, slope: Float32[Array, "n b h"]) -> tuple[Weights, Array, None]:
    """Return the derivatives by weights and inputs from those by the outputs."""
    weights, inputs, exist, reading = kept
    before = jax.tree.map(lambda after: jnp.pad(after, ((1, 0), (0, 0), (0, 0)))[:-1], reading.after)
    by_gates = _slopes_of_gates(weights, exist[..., None], reading, before.cell, slope)
    each = by_gates.reshape(-1, by_gates.shape[-1])

    def summed(factor: Array) -> Array:
        # In this order the product is of rows as they lie in memory.
        return (factor.reshape(len(each), -1).T @ each).T

    by_weights = Weights(summed(inputs), summed(before.output), jnp.sum(each, axis=0))
    return by_weights, by_gates @ weights.inputs, None


def _slopes_of_gates(
    weights: Weights, exist: Array, reading: Reading, cell: Array, slope: Array
) -> Float32[Array, "n b g"]:
    """Return the derivatives by W_ih x + W_hh h + b, shape [N, B, 4 H].

    Args:
        weights: of the network.
        exist: which inputs do, shape [N, B, 1].
        reading: what was read.
        cell: before each input, shape [N, B, H].
        slope: derivative by the outputs, shape [N, B, H].
    """
    entry, keeping, fresh, exit_ = jnp.split(reading.gates, 4, axis=-1)
    seen = jnp.tanh(reading.after.cell)
    others = jnp.concatenate([fresh, cell, 0.5 * (1 + entry), seen], axis=-1)
    by_parts = jnp.where(exist, _halves(weights) ** 2 * (1 - reading.gates**2) * others, 0)
    to_cell = jnp.where(exist, 0.5 * (1 + exit_) * (1 - seen**2), 0)
    kept = jnp.where(exist, 0.5 * (1 + keeping), 1)
    passed = jnp.where(exist, 0, 1).astype(SINGLE)

    def retreat(after: Hidden, given: tuple[Array, ...]) -> tuple[Hidden, Array]:
        slope, by_parts, to_cell, kept, passed = given
        output = after.output + slope
        cell = after.cell + output * to_cell
        by_gates = by_parts * jnp.concatenate([cell, cell, cell, output], axis=-1)
        return Hidden(passed * output + by_gates @ weights.fed_back, cell * kept), by_gates

    zeros = jnp.zeros_like(slope[0])
    given = (slope, by_parts, to_cell, kept, passed)
    return jax.lax.scan(retreat, Hidden(zeros, zeros), given, reverse=True)[1]


def _halves(weights: Weights) -> Float32[Array, " g"]:
    """Return 1 for the gate `fresh`, ½ for the others."""
    return jnp.asarray(np.repeat([0.5, 0.5, 1.0, 0.5], weights.fed_back.shape[1]), SINGLE)


_heard.defvjp(_reading, _slopes)
