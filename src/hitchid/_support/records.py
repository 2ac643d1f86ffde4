"""Frozen records that hold arrays or mappings: equality by content, hash, pickling and copying."""

from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from hitchid._support.numbers import count
from hitchid._support.screen import GAP, MAX_WIDTH, screen, shortened

# A `repr` of at most one screen for records whose fields may hold arrays or many items.

Record = TypeVar("Record", bound=type)
MAX_ITEMS, MAX_NESTED = 6, 60  # items of a sequence that are shown; characters of a nested record; chosen


def short_repr(record: Record) -> Record:
    """Decorate a dataclass or named tuple: its `repr` fits on one screen, one line if that is enough."""
    setattr(record, "__repr__", _repr)  # noqa: B010 - the type of a class has another signature
    return record


def _repr(self: object) -> str:
    content = {name: _brief(getattr(self, name)) for name in _names(self)}
    kind = type(self).__name__
    line = f"{kind}({', '.join(f'{name}={text}' for name, text in content.items())})"
    if len(line) <= MAX_WIDTH:
        return line
    width = max(map(len, content))
    starts = [f"{GAP}{name.ljust(width)}{GAP}" for name in content]
    room = MAX_WIDTH - len(starts[0])
    return screen([kind, *map(str.__add__, starts, (shortened(text, room) for text in content.values()))])


def _names(record: object) -> Sequence[str]:
    if is_dataclass(record):
        return [field.name for field in fields(record) if field.repr]
    return record._fields  # pyright: ignore[reportAttributeAccessIssue]


def _brief(value: object) -> str:
    """Return a short text of a value on one line."""
    if isinstance(value, str):
        return repr(shortened(value, MAX_NESTED))
    if value is None or isinstance(value, bool | Enum):
        return str(value)
    if isinstance(value, Real):
        return f"{float(value):.6g}"
    if hasattr(value, "shape"):
        return _brief_array(value)
    if isinstance(value, Mapping):
        items = [f"{key}: {text}" if (text := _single(item)) else f"{key}" for key, item in value.items()]
        return shortened("{" + ", ".join(items) + "}")
    if isinstance(value, tuple | list | frozenset) and not hasattr(value, "_fields"):
        texts = [_single(item) for item in value]
        if len(texts) <= MAX_ITEMS and all(texts):
            return f"({', '.join(texts)})"
        kinds = {"number" if isinstance(item, Real) else type(item).__name__ for item in value}
        return count(len(texts), kinds.pop() if len(kinds) == 1 else "item")
    return text if "\n" not in (text := repr(value)) and len(text) <= MAX_NESTED else type(value).__name__


def _single(value: object) -> str:
    """Return the text of a text or number, an empty text for anything else."""
    return _brief(value) if value is None or isinstance(value, str | Real | Enum) else ""


def _brief_array(value: object) -> str:
    try:
        array = np.asarray(value)
    except TypeError:  # an array that a JAX transformation traces has no numbers yet
        return f"array of shape {value.shape}"  # pyright: ignore[reportAttributeAccessIssue]
    if array.ndim == 0:
        return f"{array.item():.6g}" if array.dtype.kind in "fiu" else str(array.item())
    if array.size <= MAX_ITEMS and array.ndim == 1:
        return f"[{', '.join(f'{number:.6g}' for number in array.tolist())}]"
    ends = f", {array.min():.4g} to {array.max():.4g}" if array.size and array.dtype.kind in "fiu" else ""
    return f"array of shape {array.shape}{ends}"


# Notices on data and results, as records.


class Severity(Enum):
    """Severity of a notice or finding, in descending order."""

    FAULT = "fault"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Notice:
    """A fact about data or results that is reported to the user.

    `str(notice)` is the printed text, `place: sentence`.

    Attributes:
        code: identifier for programs, such as `clock-resampled`.
        sentence: printed text, without capital letter and full stop.
        place: record, file, signal or direction concerned; may be empty.
        severity: fault, warning or note.
    """

    code: str
    sentence: str
    place: str = ""
    severity: Severity = Severity.NOTE

    def __str__(self) -> str:
        """Return the printed text."""
        return f"{self.place}: {self.sentence}" if self.place else self.sentence

    def at(self, place: str) -> "Notice":
        """Return the notice with an outer place prefixed to its own."""
        return replace(self, place=f"{place}: {self.place}" if self.place else place)


class Value:
    """Base of a frozen dataclass with equality by content; declare it with `eq=False`.

    A copy, also one from another process, is built again by the constructor, which makes it read-only.
    """

    if not TYPE_CHECKING:  # otherwise a type checker takes every attribute for known

        def __getattr__(self, name: str) -> object:
            """Raise AttributeError, which names the public attributes."""
            public = {attribute for attribute in dir(type(self)) if not attribute.startswith("_")}
            public |= {field.name for field in fields(self)}
            listed = f"; expected one of {', '.join(sorted(public))}" if not name.startswith("_") else ""
            raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'{listed}")

    def __eq__(self, other: object) -> bool:
        """Return whether type and content are the same; arrays are compared sample by sample."""
        return same_fields(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        """Return the hash of the texts and numbers, and of the lengths of everything else."""
        return hash((type(self), *(_hashed(getattr(self, name)) for name in _compared(self))))

    def __reduce__(self) -> tuple:
        """Return the constructor's arguments for `pickle` and `copy`."""
        # Through the constructor: what makes a record read-only runs again.
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
        first, second = np.asarray(one), np.asarray(other)
        # NumPy can compare NaN only where both are floats.
        return np.array_equal(first, second, equal_nan=first.dtype.kind == second.dtype.kind == "f")
    return bool(one == other)


def same_fields(one: object, other: object) -> bool:
    """Return whether all compared fields of two dataclasses of one type have the same content."""
    return all(same(getattr(one, name), getattr(other, name)) for name in _compared(one))


def _compared(value: object) -> list[str]:
    return [field.name for field in fields(value) if field.compare]  # pyright: ignore[reportArgumentType]


def _hashed(value: object) -> object:
    # Of what is no text or number the length is enough: equal records have equal lengths.
    if isinstance(value, str | int | float):
        return value
    return len(value) if isinstance(value, Sized) else None
