"""Checks of arguments of public calls: the error names the argument, the requirement and the value."""

import math
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import TypeVar

import numpy as np

from hitchid.errors import InputError

Kind = TypeVar("Kind")
MAX_SHOWN = 60  # characters of a value quoted in a message


def instance(value: object, kind: type[Kind] | tuple[type[Kind], ...], name: str, required: str) -> Kind:
    """Return a value of a kind.

    Args:
        value: what came.
        kind: its type, or several.
        name: of the argument.
        required: the requirement, for the message.

    Raises:
        InputError: it is of another kind.
    """
    if not isinstance(value, kind):
        raise input_error(name, required, value)
    return value


def number(value: object, name: str, *, above: float = -math.inf) -> float:
    """Return a finite real number, from NumPy or JAX too.

    Raises:
        InputError: it is none, or not above a limit.
    """
    try:
        array = np.asarray(value)
        is_valid = array.shape == () and array.dtype.kind in "iuf" and above < float(array) < math.inf
    except (TypeError, ValueError) as error:
        raise input_error(name, "a number", value) from error
    if not is_valid:
        raise input_error(
            name, f"a finite number above {above:g}" if above > -math.inf else "a finite number", value
        )
    return float(array)


def integer(value: object, name: str, *, minimum: int = 0) -> int:
    """Return a whole number that is not below a limit; raises InputError where it is none."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < minimum:
        raise input_error(name, f"a whole number of at least {minimum}", value)
    return int(value)


def one_of(value: object, allowed: Iterable[str], name: str) -> str:
    """Return one of the known names; raises InputError where it is none of them."""
    names = tuple(allowed)
    if not isinstance(value, str) or value not in names:
        raise input_error(name, f"one of {', '.join(names)}", value)
    return value


def path(value: object, name: str) -> Path:
    """Return a path; raises InputError where it is neither text nor a path."""
    return Path(instance(value, (str, Path), name, "a path"))


def tuple_of(
    values: object, kind: type[Kind] | tuple[type[Kind], ...], name: str, required: str
) -> tuple[Kind, ...]:
    """Return values of a kind out of anything that can be gone through, but text; raises InputError."""
    if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
        raise input_error(name, required, values)
    return tuple(instance(value, kind, name, required) for value in values)


def mapping_of(values: object, allowed: Iterable[str], name: str) -> Mapping[str, object]:
    """Return a mapping whose keys are all known; raises InputError."""
    mapping = instance(values, Mapping, name, "a mapping")
    for key in mapping:
        one_of(key, allowed, f"{name}: key")
    return mapping


def input_error(name: str, required: str, value: object) -> InputError:
    """Return the error about a value."""
    text = repr(value)
    shown = text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"
    return InputError(f"{name}: required {required}, came {type(value).__name__} {shown}")
