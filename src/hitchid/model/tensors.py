"""Conversion between the trained parts of a model and named tensors."""

from collections.abc import Mapping
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Part = TypeVar("Part")
Tensors = Mapping[str, np.ndarray]
MAX_NUMBER = 1e9  # size of a stored number, beyond which products of two are no weights; chosen


def tensors_of(tree: object, prefix: str) -> dict[str, np.ndarray]:
    """Return path to array, `prefix/field/…`, for every array of a part."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {_name(prefix, path): np.array(leaf, order="C") for path, leaf in leaves}


def fill(skeleton: Part, tensors: Tensors, prefix: str) -> Part:
    """Return a copy of a skeleton filled with the stored arrays of a prefix.

    Raises:
        ValueError: an array is missing, has another shape or type than the skeleton's, or a number that no
            training gives. Only what is infinite in the skeleton may be.
    """

    def leaf(path: tuple, like: np.ndarray | jax.Array) -> object:
        name = _name(prefix, path)
        stored = tensors.get(name)
        if stored is None or stored.shape != like.shape or stored.dtype != like.dtype:
            got = "none" if stored is None else f"shape {stored.shape}, {stored.dtype}"
            raise ValueError(f"{name}: got {got}, expected shape {like.shape}, {like.dtype}")
        admissible = (np.abs(stored) <= MAX_NUMBER) | (np.isinf(like) & (stored == like))
        if not np.all(admissible):
            raise ValueError(f"{name}: got {stored[~admissible].flat[0]}, expected numbers within ±1e9")
        return stored if isinstance(like, np.ndarray) else jnp.asarray(stored)

    return jax.tree_util.tree_map_with_path(leaf, skeleton)


def shapes_of(tensors: Tensors, prefix: str) -> dict[str, tuple[int, ...]]:
    """Return path without prefix to shape, for every stored array of a prefix."""
    start = f"{prefix}/"
    return {
        name.removeprefix(start): stored.shape for name, stored in tensors.items() if name.startswith(start)
    }


def check_known(tensors: Tensors, read: Tensors) -> None:
    """Check that all stored arrays were read.

    Raises:
        ValueError: there are others.
    """
    if unknown := sorted(tensors.keys() - read.keys()):
        raise ValueError(f"{unknown[0]}: is not known; expected {len(read)} arrays, got {len(tensors)}")


def check_size(tensors: Tensors, count: int) -> None:
    """Check that a described size does not exceed the stored arrays, before memory is allocated.

    Raises:
        ValueError: the stored arrays have fewer elements.
    """
    if count > sum(stored.size for stored in tensors.values()):
        raise ValueError("the description lists more weights than the tensor file contains")


def _name(prefix: str, path: tuple) -> str:
    return f"{prefix}/{jax.tree_util.keystr(path, simple=True, separator='/')}"
