"""A state as two flat arrays and a step as two programs: handing over must not cost more than the work."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Float32, PyTree

from hitchid.model.stepping import Motion, State


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

    def __init__(self, like: State) -> None:
        self._unravel = _unravel(like._replace(hidden=None))

    def pack(self, state: State) -> Packed:
        """Lay a state's arrays end to end."""
        return Packed(ravel_pytree(state._replace(hidden=None))[0], state.hidden)

    def unpack(self, packed: Packed) -> State:
        """Return the state again."""
        return self._unravel(packed.numbers)._replace(hidden=packed.hidden)

    def step(self, motion: Motion) -> Callable[[Packed, ArrayLike], tuple[Packed, Array]]:
        """Return the compiled step of a motion, from packed state to packed state and displacement.

        It is two programs: one that holds small arrays and a network's weights together is run by several
        threads, whose handing over takes several times as long as the work. What is given is lifting and
        lowering command and measured displacement, shape [3].
        """
        questions = _unravel(
            jax.eval_shape(lambda: motion.move(motion.standing(), jnp.zeros(2), jnp.zeros(()))[1])
        )

        @jax.jit
        def moved(numbers: Array, given: Array) -> tuple[Array, Array]:
            state = self.unpack(Packed(numbers, motion.blank()))
            after, question = motion.move(state, given[:2], given[2])
            return self.pack(after).numbers, ravel_pytree(question)[0]

        @jax.jit
        def answered(numbers: Array, hidden: Array, question: Array) -> tuple[Array, Array, Array]:
            hidden, error, displacement = motion.answer(hidden, questions(question))
            return numbers.at[:2].set(jnp.stack([displacement, error])), hidden, displacement

        def step(state: Packed, given: ArrayLike) -> tuple[Packed, Array]:
            numbers, question = moved(state.numbers, given)
            numbers, hidden, displacement = answered(numbers, state.hidden, question)
            return Packed(numbers, hidden), displacement

        return step


def _unravel(like: PyTree) -> Callable[[Float[Array, " n"]], Any]:
    """Return what makes arrays of one structure again of numbers laid end to end."""
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like))[1]
