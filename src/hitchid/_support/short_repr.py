"""A `repr` of at most one screen for records whose fields may hold arrays or many items."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from numbers import Real
from typing import TypeVar

import numpy as np

from hitchid._support.summary import GAP, MAX_WIDTH, count, screen, shortened

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
        return _brief_items(list(value))
    return text if "\n" not in (text := repr(value)) and len(text) <= MAX_NESTED else type(value).__name__


def _brief_items(items: list) -> str:
    texts = [_single(item) for item in items]
    if len(items) <= MAX_ITEMS and all(texts):
        return f"({', '.join(texts)})"
    kinds = {"number" if isinstance(item, Real) else type(item).__name__ for item in items}
    return count(len(items), kinds.pop() if len(kinds) == 1 else "item")


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
