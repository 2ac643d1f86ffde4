"""Frozen records that hold arrays or mappings: equality by content, hash, pickling and copying."""

from collections.abc import Mapping, Sized
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np


class Value:
    """Base of a frozen dataclass with equality by content; declare it with `eq=False`.

    A copy, also one from another process, is built again by the constructor, which makes it read-only.
    """

    if not TYPE_CHECKING:  # otherwise a type checker takes every attribute for known

        def __getattr__(self, name: str) -> object:
            """Raise AttributeError, which names the public attributes."""
            known = [known for known in dir(type(self)) if not known.startswith("_")]
            known += [field.name for field in fields(self) if field.name not in known]
            listed = f"; expected one of {', '.join(sorted(known))}" if not name.startswith("_") else ""
            raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'{listed}")

    def __eq__(self, other: object) -> bool:
        """Return whether type and content are the same; arrays are compared sample by sample."""
        return same_fields(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        """Return the hash of the texts and numbers, and of the lengths of everything else."""
        return hash((type(self), *(_hashed(getattr(self, name)) for name in _compared(self))))

    def __reduce__(self) -> tuple:
        """Return the constructor's arguments for `pickle` and `copy`."""
        return rebuild, (type(self), field_values(self))


def field_values(value: object) -> dict[str, object]:
    """Return field name to value; read-only views of mappings, which cannot be pickled, become dicts."""
    content = {field.name: getattr(value, field.name) for field in fields(value)}  # pyright: ignore[reportArgumentType]
    return {
        name: dict(item) if isinstance(item, MappingProxyType) else item for name, item in content.items()
    }


def rebuild(kind: type, content: Mapping[str, object]) -> object:
    """Return an instance of a dataclass from its fields."""
    return kind(**content)


def same(one: object, other: object) -> bool:
    """Return whether two values have the same content; NaN equals NaN, an exception one with its message."""
    if one is other:
        return True
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Exception) and type(one) is type(other):
        return str(one) == str(other)
    if is_dataclass(one) and type(one) is type(other):
        return same_fields(one, other)
    if hasattr(one, "__array__") or isinstance(one, float):
        return _same_numbers(one, other)
    return bool(one == other)


def same_fields(one: object, other: object) -> bool:
    """Return whether all compared fields of two dataclasses of one type have the same content."""
    return all(same(getattr(one, name), getattr(other, name)) for name in _compared(one))


def _compared(value: object) -> list[str]:
    return [field.name for field in fields(value) if field.compare]  # pyright: ignore[reportArgumentType]


def _same_numbers(one: object, other: object) -> bool:
    first, second = np.asarray(one), np.asarray(other)
    return np.array_equal(first, second, equal_nan=first.dtype.kind == second.dtype.kind == "f")


def _hashed(value: object) -> object:
    if isinstance(value, str | int | float):
        return value
    return len(value) if isinstance(value, Sized) else None
