"""State as two flat arrays and step as two compiled functions, to keep the cost of a call small."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Float32, PyTree

from hitchid._support.short_repr import short_repr
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.state import HitchState


@short_repr
class Packed(NamedTuple):
    """State of a hitch in two arrays.

    Attributes:
        numbers: all arrays but `hidden`, concatenated; what the network completes first, shape [n].
        hidden: LSTM states of the network of the active channel, shape [2, 2, H].
    """

    numbers: Float[Array, " n"]
    hidden: Float32[Array, "2 2 h"]


class Packing:
    """Conversion between states of one hitch and packed states.

    Args:
        like: a state of that hitch.
    """

    def __init__(self, like: HitchState) -> None:
        self._unravel = unravel(like._replace(hidden=None))

    def pack(self, state: HitchState) -> Packed:
        """Return a state in packed form."""
        return Packed(ravel_pytree(state._replace(hidden=None))[0], state.hidden)

    def unpack(self, packed: Packed) -> HitchState:
        """Return the state of a packed one."""
        return self._unravel(packed.numbers)._replace(hidden=packed.hidden)

    def step(self, dynamics: HitchDynamics) -> Callable[[Packed, ArrayLike], tuple[Packed, Array]]:
        """Return the compiled step function, from packed state to packed state and displacement.

        Its inputs are lifting command, lowering command and measured displacement, shape [3]. It is compiled
        as two functions: XLA runs a single one, with small arrays and the weights of a network, on several
        threads whose synchronisation takes several times as long as the computation.
        """
        numbers_of_models, _ = ravel_pytree(dynamics.discrete_models)
        run_physics = jax.jit(partial(self._physics, dynamics, numbers_of_models))
        run_network = self._network(dynamics)

        def step(state: Packed, inputs: ArrayLike) -> tuple[Packed, Array]:
            numbers, network_input = run_physics(state.numbers, inputs)
            return run_network(numbers, network_input, state.hidden)

        return step

    def adjustable_step(
        self, dynamics: HitchDynamics
    ) -> Callable[[Float[Array, " p"], Packed, ArrayLike], tuple[Packed, Array]]:
        """Return `step` with the numbers of the physical models as its first argument, in one array."""
        run_physics = jax.jit(partial(self._physics, dynamics))
        run_network = self._network(dynamics)

        def step(
            numbers_of_models: Float[Array, " p"], state: Packed, inputs: ArrayLike
        ) -> tuple[Packed, Array]:
            numbers, network_input = run_physics(numbers_of_models, state.numbers, inputs)
            return run_network(numbers, network_input, state.hidden)

        return step

    def _physics(
        self, dynamics: HitchDynamics, numbers_of_models: Array, numbers: Array, inputs: Array
    ) -> tuple[Array, Array]:
        """Return the state without the network's prediction, and the inputs of the network."""
        dynamics = with_numbers(dynamics, numbers_of_models)
        state = self.unpack(Packed(numbers, dynamics.zero_lstm_state()))
        next_state, network_input = dynamics.advance_physics(state, inputs[:2], inputs[2])
        return self.pack(next_state).numbers, ravel_pytree(network_input)[0]

    def _network(self, dynamics: HitchDynamics) -> Callable[[Array, Array, Array], tuple[Packed, Array]]:
        """Return the compiled prediction of the network."""
        unravel_input = unravel(
            jax.eval_shape(
                lambda: dynamics.advance_physics(dynamics.standing_state(), jnp.zeros(2), jnp.zeros(()))[1]
            )
        )

        @jax.jit
        def run(numbers: Array, hidden: Array, network_input: Array) -> tuple[Array, Array, Array]:
            hidden, output = dynamics.advance_network(hidden, unravel_input(network_input))
            return numbers.at[: len(output)].set(jnp.stack(output)), hidden, output.displacement

        def predict(numbers: Array, network_input: Array, hidden: Array) -> tuple[Packed, Array]:
            numbers, hidden, displacement = run(numbers, hidden, network_input)
            return Packed(numbers, hidden), displacement

        return predict


def with_numbers(dynamics: HitchDynamics, numbers: Float[Array, " p"]) -> HitchDynamics:
    """Return dynamics whose physical models have other numbers, as `ravel_pytree` orders them."""
    models = ravel_pytree(dynamics.discrete_models)[1](numbers)
    return eqx.tree_at(lambda tree: tree.discrete_models, dynamics, models)


def unravel(like: PyTree) -> Callable[[Float[Array, " n"]], Any]:
    """Return the function from concatenated numbers back to arrays of one structure."""
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like))[1]
