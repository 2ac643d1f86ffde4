"""A structured state as three flat arrays: handing over a few arrays costs less than the step itself."""

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32, Int

Structured = TypeVar("Structured")


class Packed(NamedTuple):
    """Every array of a state, laid end to end by type.

    Attributes:
        numbers: double precision, shape [n].
        hidden: single precision, shape [m].
        counts: integers and truth values, shape [k].
    """

    numbers: Float[Array, " n"]
    hidden: Float32[Array, " m"]
    counts: Int[Array, " k"]


class Packing(Generic[Structured]):
    """How states of one structure are laid out.

    Args:
        like: a state of that structure.
    """

    def __init__(self, like: Structured) -> None:
        leaves, self._structure = jax.tree.flatten(like)
        self._shapes = [(leaf.shape, leaf.dtype) for leaf in leaves]

    def pack(self, state: Structured) -> Packed:
        """Lay a state's arrays end to end."""
        parts: dict[str, list[Array]] = {field: [] for field in Packed._fields}
        for leaf, (_, dtype) in zip(jax.tree.leaves(state), self._shapes, strict=True):
            parts[_field(dtype)].append(jnp.ravel(leaf))
        kinds = (jnp.float64, jnp.float32, jnp.int64)
        return Packed(
            *(
                jnp.concatenate([jnp.zeros(0, kind), *(part.astype(kind) for part in parts[field])])
                for field, kind in zip(Packed._fields, kinds, strict=True)
            )
        )

    def unpack(self, packed: Packed) -> Structured:
        """Return the state again."""
        used = dict.fromkeys(Packed._fields, 0)
        leaves = []
        for shape, dtype in self._shapes:
            field = _field(dtype)
            size = int(np.prod(shape))
            part = getattr(packed, field)[used[field] : used[field] + size]
            leaves.append(part.reshape(shape).astype(dtype))
            used[field] += size
        return jax.tree.unflatten(self._structure, leaves)

    def stepping(self, step: Callable[..., tuple[Structured, Array]]) -> Callable[..., tuple[Packed, Array]]:
        """Return a compiled step from packed state to packed state."""

        def packed(state: Packed, *given: Array) -> tuple[Packed, Array]:
            after, answer = step(self.unpack(state), *given)
            return self.pack(after), answer

        return jax.jit(packed)


def _field(dtype: np.dtype) -> str:
    if np.issubdtype(dtype, np.floating):
        return "numbers" if dtype == np.float64 else "hidden"
    return "counts"
