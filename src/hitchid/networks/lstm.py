"""LSTM with one linear output, in single precision: the recurrent network of the compensator."""

from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float32, PRNGKeyArray

SINGLE = jnp.float32  # type of all weights, states and inputs of the networks


class LstmState(NamedTuple):
    """Hidden state h and cell state c of an LSTM, each of shape [..., H]."""

    h: Float32[Array, "*b h"]
    c: Float32[Array, "*b h"]


class Lstm(eqx.Module):
    """LSTM with one layer and a linear output; all of its arrays are trained."""

    cell: eqx.nn.LSTMCell
    head: eqx.nn.Linear

    @classmethod
    def init(cls, key: PRNGKeyArray, inputs: int, hidden: int) -> "Lstm":
        """Return a network with cell weights uniform in ±1/√H and an output of zero."""
        # NumPy generator: compiling that of JAX takes longer than compiling the network.
        rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
        bound = 1 / np.sqrt(hidden)

        def random_weights(array: jax.ShapeDtypeStruct) -> Array:
            return jnp.asarray(rng.uniform(-bound, bound, array.shape), SINGLE)

        def zero_weights(array: jax.ShapeDtypeStruct) -> Array:
            return jnp.asarray(np.zeros(array.shape), SINGLE)

        cell = eqx.filter_eval_shape(eqx.nn.LSTMCell, inputs, hidden, dtype=SINGLE, key=key)
        head = eqx.filter_eval_shape(eqx.nn.Linear, hidden, 1, dtype=SINGLE, key=key)
        return cls(jax.tree.map(random_weights, cell), jax.tree.map(zero_weights, head))

    def zero_state(self, shape: tuple[int, ...]) -> LstmState:
        """Return the state before the first input, all zeros, for sequences of a shape."""
        zeros = jnp.zeros((*shape, self.cell.hidden_size), SINGLE)
        return LstmState(zeros, zeros)

    def step(self, hidden: LstmState, inputs: Float32[Array, "*b i"], *, fused: bool = False) -> LstmState:
        """Return the state after one input vector for each sequence, of any shape [b].

        Args:
            hidden: state before the input.
            inputs: input vectors.
            fused: one matrix product for inputs and state instead of two. Its derivative takes a third less
                time, but its rounding depends more on the surrounding program.
        """
        cell = self.cell
        # Batched matrix products; `jax.vmap` over the cell of equinox would give many small ones.
        if fused:
            inputs_and_h = jnp.concatenate([inputs, hidden.h], axis=-1)
            gates = inputs_and_h @ jnp.concatenate([cell.weight_ih, cell.weight_hh], axis=1).T
        else:
            gates = inputs @ cell.weight_ih.T + hidden.h @ cell.weight_hh.T
        gates = gates + cast(Array, cell.bias)
        i, f, g, o = jnp.split(gates, 4, axis=-1)
        c = jax.nn.sigmoid(f) * hidden.c + jax.nn.sigmoid(i) * jnp.tanh(g)
        return LstmState(jax.nn.sigmoid(o) * jnp.tanh(c), c)

    def output(self, hidden: LstmState) -> Float32[Array, "*b"]:
        """Return the output of the linear layer for each sequence."""
        return self._linear_output(hidden.h)

    def unroll(self, inputs: Float32[Array, "n b i"], valid: Bool[Array, "n b"]) -> Float32[Array, "n b"]:
        """Return the network's output after each of N inputs of B sequences, from the zero state.

        Same result as `step` and `output` input by input, faster, also in the derivative. An input that is
        not valid leaves the state unchanged.
        """
        weights = LstmWeights(self.cell.weight_ih, self.cell.weight_hh, cast(Array, self.cell.bias))
        return self._linear_output(_unrolled_outputs(weights, inputs, valid))

    def _linear_output(self, h: Float32[Array, "*b h"]) -> Float32[Array, "*b"]:
        return h @ self.head.weight[0] + cast(Array, self.head.bias)[0]


class LstmWeights(NamedTuple):
    """Weights and bias of the gates: W_ih, shape [4 H, I], W_hh, shape [4 H, H], and b, shape [4 H]."""

    weight_ih: Float32[Array, "g i"]
    weight_hh: Float32[Array, "g h"]
    bias: Float32[Array, " g"]


class VjpResiduals(NamedTuple):
    """Values of the forward pass that the derivative needs.

    Attributes:
        gates: tanh of i/2, f/2, g and o/2 before activation, shape [N, B, 4 H].
        states: the state after each input, shape [N, B, H].
    """

    gates: Float32[Array, "n b g"]
    states: LstmState


@jax.custom_vjp
def _unrolled_outputs(weights: LstmWeights, inputs: Array, valid: Array) -> Float32[Array, "n b h"]:
    """Return h after each input.

    Terms that do not depend on the state are computed for all inputs at once, outside the loop. In the
    derivative the loop gives the derivatives by the gates; those by the weights are one product over all
    inputs, which the automatic derivative of JAX would sum input by input.
    """
    return _unroll(weights, inputs, valid).states.h


def _unroll(weights: LstmWeights, inputs: Array, valid: Array) -> VjpResiduals:
    halves = _gate_scales(weights)
    input_terms = inputs @ (weights.weight_ih.T * halves) + weights.bias * halves
    recurrent_weights = weights.weight_hh.T * halves

    def advance(previous: LstmState, inputs_at_sample: tuple[Array, Array]) -> tuple[LstmState, VjpResiduals]:
        input_term, is_valid = inputs_at_sample
        # σ(x) = ½ + ½ tanh(x/2): one function for all four gates.
        gates = jnp.tanh(input_term + previous.h @ recurrent_weights)
        i, f, g, o = jnp.split(gates, 4, axis=-1)
        c = 0.5 * ((1 + f) * previous.c + (1 + i) * g)
        c = jnp.where(is_valid, c, previous.c)
        h = jnp.where(is_valid, 0.5 * (1 + o) * jnp.tanh(c), previous.h)
        state = LstmState(h, c)
        return state, VjpResiduals(gates, state)

    zeros = jnp.zeros((inputs.shape[1], weights.weight_hh.shape[1]), SINGLE)
    return jax.lax.scan(advance, LstmState(zeros, zeros), (input_terms, valid[..., None]))[1]


def _unroll_forward(weights: LstmWeights, inputs: Array, valid: Array) -> tuple[Array, tuple]:
    residuals = _unroll(weights, inputs, valid)
    return residuals.states.h, (weights, inputs, valid, residuals)


def _unroll_backward(
    saved: tuple, output_gradient: Float32[Array, "n b h"]
) -> tuple[LstmWeights, Array, None]:
    """Return the derivatives by weights and inputs from those by the outputs."""
    weights, inputs, valid, residuals = saved
    previous = jax.tree.map(lambda state: jnp.pad(state, ((1, 0), (0, 0), (0, 0)))[:-1], residuals.states)
    gate_gradients = _gate_gradients(weights, valid[..., None], residuals, previous.c, output_gradient)
    gradient_rows = gate_gradients.reshape(-1, gate_gradients.shape[-1])

    def weight_gradient(factor: Array) -> Array:
        # In this order the product runs along rows that are contiguous in memory.
        return (factor.reshape(len(gradient_rows), -1).T @ gradient_rows).T

    weight_gradients = LstmWeights(
        weight_gradient(inputs), weight_gradient(previous.h), jnp.sum(gradient_rows, axis=0)
    )
    return weight_gradients, gate_gradients @ weights.weight_ih, None


def _gate_gradients(
    weights: LstmWeights, valid: Array, residuals: VjpResiduals, previous_c: Array, output_gradient: Array
) -> Float32[Array, "n b g"]:
    """Return the derivatives by W_ih x + W_hh h + b, shape [N, B, 4 H]."""
    i, f, g, o = jnp.split(residuals.gates, 4, axis=-1)
    tanh_c = jnp.tanh(residuals.states.c)
    factors = jnp.concatenate([g, previous_c, 0.5 * (1 + i), tanh_c], axis=-1)
    gate_derivatives = jnp.where(valid, _gate_scales(weights) ** 2 * (1 - residuals.gates**2) * factors, 0)
    h_to_c = jnp.where(valid, 0.5 * (1 + o) * (1 - tanh_c**2), 0)
    forget_gate = jnp.where(valid, 0.5 * (1 + f), 1)
    pass_through = jnp.where(valid, 0, 1).astype(SINGLE)

    def step_back(next_gradient: LstmState, saved_at_sample: tuple[Array, ...]) -> tuple[LstmState, Array]:
        output_gradient, gate_derivatives, h_to_c, forget_gate, pass_through = saved_at_sample
        h_gradient = next_gradient.h + output_gradient
        c_gradient = next_gradient.c + h_gradient * h_to_c
        gate_gradients = gate_derivatives * jnp.concatenate(
            [c_gradient, c_gradient, c_gradient, h_gradient], axis=-1
        )
        return LstmState(
            pass_through * h_gradient + gate_gradients @ weights.weight_hh, c_gradient * forget_gate
        ), gate_gradients

    zeros = jnp.zeros_like(output_gradient[0])
    saved_arrays = (output_gradient, gate_derivatives, h_to_c, forget_gate, pass_through)
    return jax.lax.scan(step_back, LstmState(zeros, zeros), saved_arrays, reverse=True)[1]


def _gate_scales(weights: LstmWeights) -> Float32[Array, " g"]:
    """Return the factor before tanh for each gate: 1 for g, ½ for i, f and o."""
    return jnp.asarray(np.repeat([0.5, 0.5, 1.0, 0.5], weights.weight_hh.shape[1]), SINGLE)


_unrolled_outputs.defvjp(_unroll_forward, _unroll_backward)
