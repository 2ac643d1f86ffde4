"""LSTM with its own position as an input, whose output are increments of it, in single precision."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float32

SINGLE = jnp.float32  # type of all weights, states and inputs


class IntegratingLstm(eqx.Module):
    """LSTM in a loop with an integrator.

    At each block k: (h, c) = LSTM(inputs(k), x, h, c), then M increments σ (W h + b), added to x one by one.

    An ensemble has a leading axis over its members in each array.

    Attributes:
        weight_ih: from inputs to gates i, f, g, o, shape [I, 4 H].
        weight_hh: from the last output h and the position x to gates, shape [H + 1, 4 H].
        bias: of the gates, shape [4 H].
        head: from h to increments, shape [H, M].
        head_bias: of the increments, shape [M].
    """

    weight_ih: Float32[Array, "*e i g"]
    weight_hh: Float32[Array, "*e h1 g"]
    bias: Float32[Array, "*e g"]
    head: Float32[Array, "*e h m"]
    head_bias: Float32[Array, "*e m"]

    @classmethod
    def init(cls, rng: np.random.Generator, inputs: int, hidden: int, increments: int) -> "IntegratingLstm":
        """Return a network with gate weights uniform in ±1/√H and increments of zero: it stands still."""
        bound = 1 / np.sqrt(hidden)

        def random_weights(*shape: int) -> Array:
            return jnp.asarray(rng.uniform(-bound, bound, shape), SINGLE)

        return cls(
            random_weights(inputs, 4 * hidden),
            random_weights(hidden + 1, 4 * hidden),
            random_weights(4 * hidden),
            jnp.zeros((hidden, increments), SINGLE),
            jnp.zeros(increments, SINGLE),
        )

    def simulate(
        self, inputs: Float32[Array, "k b i"], start: Float32[Array, " b"], scale: Float32[Array, ""]
    ) -> Float32[Array, "k b m"]:
        """Return positions after each increment.

        Args:
            inputs: of K blocks of B tests, shape [K, B, I].
            start: position before the first block, shape [B].
            scale: factor on the increments, shape [].
        """
        head, head_bias = scale * self.head, scale * self.head_bias
        input_terms = inputs @ self.weight_ih + self.bias

        def advance(state: tuple[Array, Array, Array], terms: Array) -> tuple[tuple, Array]:
            h, c, position = state
            # σ(x) = ½ + ½ tanh(x/2): one function for all gates; the factor ½ is left to the weights.
            gates = jnp.tanh(terms + jnp.concatenate([h, position[:, None]], axis=1) @ self.weight_hh)
            i, f, g, o = jnp.split(gates, 4, axis=1)
            c = 0.5 * ((1 + f) * c + (1 + i) * g)
            h = 0.5 * (1 + o) * jnp.tanh(c)
            positions = position[:, None] + jnp.cumsum(h @ head + head_bias, axis=1)
            return (h, c, positions[:, -1]), positions

        zeros = jnp.zeros((inputs.shape[1], self.head.shape[0]), SINGLE)
        return jax.lax.scan(advance, (zeros, zeros, start), input_terms)[1]
