"""Arrays of the trained parts of a model as named tensors, and back."""

from collections.abc import Mapping
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Part = TypeVar("Part")
Tensors = Mapping[str, np.ndarray]


def tensors_of(part: object, prefix: str) -> dict[str, np.ndarray]:
    """Return every array of a part by its path, `prefix/field/…`."""
    leaves = jax.tree_util.tree_leaves_with_path(part)
    return {_name(prefix, path): np.array(leaf, order="C") for path, leaf in leaves}


def fill(skeleton: Part, tensors: Tensors, prefix: str) -> Part:
    """Return a part like a skeleton with the arrays of that prefix.

    Raises:
        ValueError: an array has another shape or type than the skeleton's.
        KeyError: an array is missing.
    """

    def leaf(path: tuple, like: np.ndarray | jax.Array) -> object:
        name = _name(prefix, path)
        stored = tensors[name]
        if stored.shape != like.shape or stored.dtype != like.dtype:
            raise ValueError(f"{name} has shape {stored.shape} and type {stored.dtype}")
        return stored if isinstance(like, np.ndarray) else jnp.asarray(stored)

    return jax.tree_util.tree_map_with_path(leaf, skeleton)


def shapes_of(tensors: Tensors, prefix: str) -> dict[str, tuple[int, ...]]:
    """Return path to shape of the arrays of a prefix."""
    start = f"{prefix}/"
    return {
        name.removeprefix(start): stored.shape for name, stored in tensors.items() if name.startswith(start)
    }


def check_size(tensors: Tensors, count: int) -> None:
    """Refuse a size larger than all arrays together, before memory for it is allocated.

    Raises:
        ValueError: there are fewer numbers.
    """
    if count > sum(stored.size for stored in tensors.values()):
        raise ValueError("the description has more weights than the tensors")


def _name(prefix: str, path: tuple) -> str:
    return f"{prefix}/{jax.tree_util.keystr(path, simple=True, separator='/')}"
