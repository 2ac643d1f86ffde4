"""A state as two flat arrays and a step as two programs: handing over must not cost more than the work."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Float32, PyTree

from hitchid.model.dynamics import HitchDynamics
from hitchid.model.state import HitchState


class Packed(NamedTuple):
    """Every array of a state.

    Attributes:
        numbers: all but the network's, end to end; displacement and predicted error come first, shape [n].
        hidden: of the network in charge, shape [2, 2, H].
    """

    numbers: Float[Array, " n"]
    hidden: Float32[Array, "2 2 h"]


class Packing:
    """How states of one hitch are laid out.

    Args:
        like: a state of that hitch.
    """

    def __init__(self, like: HitchState) -> None:
        self._unravel = _unravel(like._replace(hidden=None))

    def pack(self, state: HitchState) -> Packed:
        """Lay a state's arrays end to end."""
        return Packed(ravel_pytree(state._replace(hidden=None))[0], state.hidden)

    def unpack(self, packed: Packed) -> HitchState:
        """Return the state again."""
        return self._unravel(packed.numbers)._replace(hidden=packed.hidden)

    def step(self, dynamics: HitchDynamics) -> Callable[[Packed, ArrayLike], tuple[Packed, Array]]:
        """Return the compiled step of a motion, from packed state to packed state and displacement.

        It is two programs: one that holds small arrays and a network's weights together is run by several
        threads, whose handing over takes several times as long as the work. What is given is lifting and
        lowering command and measured displacement, shape [3].
        """
        unravel_input = _unravel(
            jax.eval_shape(
                lambda: dynamics.advance_physics(dynamics.standing_state(), jnp.zeros(2), jnp.zeros(()))[1]
            )
        )

        @jax.jit
        def run_physics(numbers: Array, inputs: Array) -> tuple[Array, Array]:
            state = self.unpack(Packed(numbers, dynamics.zero_lstm_state()))
            next_state, network_input = dynamics.advance_physics(state, inputs[:2], inputs[2])
            return self.pack(next_state).numbers, ravel_pytree(network_input)[0]

        @jax.jit
        def run_network(numbers: Array, hidden: Array, network_input: Array) -> tuple[Array, Array, Array]:
            hidden, error, displacement = dynamics.advance_network(hidden, unravel_input(network_input))
            return numbers.at[:2].set(jnp.stack([displacement, error])), hidden, displacement

        def step(state: Packed, inputs: ArrayLike) -> tuple[Packed, Array]:
            numbers, network_input = run_physics(state.numbers, inputs)
            numbers, hidden, displacement = run_network(numbers, state.hidden, network_input)
            return Packed(numbers, hidden), displacement

        return step


def _unravel(like: PyTree) -> Callable[[Float[Array, " n"]], Any]:
    """Return what makes arrays of one structure again of numbers laid end to end."""
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like))[1]
