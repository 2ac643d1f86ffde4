"""State as two flat arrays, to keep the cost of a call of a compiled function small."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Float32, PyTree

from hitchid._support.short_repr import short_repr
from hitchid.model.dynamics import HitchDynamics
from hitchid.model.state import HitchState, Switching


@short_repr
class Packed(NamedTuple):
    """State of a hitch in two arrays.

    Attributes:
        numbers: all arrays but `hidden`, concatenated, shape [n].
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
        numbers = like._replace(hidden=None)
        self._unravel = unravel(numbers)
        self._mode, self._both_valves_active = (
            _position(numbers, name) for name in ("mode", "both_valves_active")
        )

    def pack(self, state: HitchState) -> Packed:
        """Return a state in packed form."""
        return Packed(ravel_pytree(state._replace(hidden=None))[0], state.hidden)

    def unpack(self, packed: Packed) -> HitchState:
        """Return the state of a packed one."""
        return self._unravel(packed.numbers)._replace(hidden=packed.hidden)

    def switching(self, packed: Packed) -> Switching:
        """Return which valves are in charge, read from the numbers without a compiled function."""
        numbers = np.asarray(packed.numbers)
        return Switching(int(numbers[self._mode]), bool(numbers[self._both_valves_active]))

    def step(self, dynamics: HitchDynamics) -> Callable[[Packed, ArrayLike], tuple[Packed, Array]]:
        """Return the compiled step function, from packed state to packed state and displacement.

        Its inputs are lifting command, lowering command and measured displacement, shape [3].
        """
        return jax.jit(partial(self._step, dynamics))

    def adjustable_step(
        self, dynamics: HitchDynamics
    ) -> Callable[[Float[Array, " p"], Packed, ArrayLike], tuple[Packed, Array]]:
        """Return `step` with the numbers of the physical models as its first argument, in one array."""
        return jax.jit(lambda numbers, *arguments: self._step(with_numbers(dynamics, numbers), *arguments))

    def _step(
        self, dynamics: HitchDynamics, state: Packed, inputs: Float[Array, "3"]
    ) -> tuple[Packed, Array]:
        next_state, displacement = dynamics.step(self.unpack(state), inputs[:2], inputs[2])
        return self.pack(next_state), displacement


def with_numbers(dynamics: HitchDynamics, numbers: Float[Array, " p"]) -> HitchDynamics:
    """Return dynamics whose physical models have other numbers, as `ravel_pytree` orders them."""
    models = ravel_pytree(dynamics.discrete_models)[1](numbers)
    return eqx.tree_at(lambda tree: tree.discrete_models, dynamics, models)


def _position(state: HitchState, name: str) -> int:
    """Return where a field of a state begins in its concatenated numbers."""
    before = state[: state._fields.index(name)]
    return sum(leaf.size for leaf in jax.tree.leaves(before))


def unravel(like: PyTree) -> Callable[[Float[Array, " n"]], Any]:
    """Return the function from concatenated numbers back to arrays of one structure."""
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like))[1]
