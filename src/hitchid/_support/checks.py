"""What a caller hands in, checked where it enters: a complaint says what was required and what came."""

import math
from collections.abc import Iterable, Mapping
from numbers import Integral
from pathlib import Path
from typing import TypeVar

import numpy as np

from hitchid.errors import InputError

Kind = TypeVar("Kind")
SHOWN = 60


def instance(value: object, kind: type[Kind] | tuple[type[Kind], ...], name: str, required: str) -> Kind:
    """Return a value of a kind.

    Args:
        value: what came.
        kind: its type, or several.
        name: of the argument.
        required: what the complaint asks for.

    Raises:
        InputError: it is of another kind.
    """
    if not isinstance(value, kind):
        raise refusal(name, required, value)
    return value


def number(value: object, name: str, *, above: float = -math.inf) -> float:
    """Return a finite real number, from NumPy or JAX too.

    Raises:
        InputError: it is none, or not above a limit.
    """
    try:
        found = np.asarray(value)
        fits = found.shape == () and found.dtype.kind in "iuf" and above < float(found) < math.inf
    except (TypeError, ValueError) as error:
        raise refusal(name, "a number", value) from error
    if not fits:
        raise refusal(
            name, f"a finite number above {above:g}" if above > -math.inf else "a finite number", value
        )
    return float(found)


def whole(value: object, name: str, *, least: int = 0) -> int:
    """Return a whole number that is not below a limit; raises InputError where it is none."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise refusal(name, f"a whole number of at least {least}", value)
    return int(value)


def chosen(value: object, known: Iterable[str], name: str) -> str:
    """Return one of the known names; raises InputError where it is none of them."""
    names = tuple(known)
    if not isinstance(value, str) or value not in names:
        raise refusal(name, f"one of {', '.join(names)}", value)
    return value


def path(value: object, name: str) -> Path:
    """Return a path; raises InputError where it is neither text nor a path."""
    return Path(instance(value, (str, Path), name, "a path"))


def several(
    values: object, kind: type[Kind] | tuple[type[Kind], ...], name: str, required: str
) -> tuple[Kind, ...]:
    """Return values of a kind out of anything that can be gone through, but text; raises InputError."""
    if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
        raise refusal(name, required, values)
    return tuple(instance(value, kind, name, required) for value in values)


def keyed(values: object, known: Iterable[str], name: str) -> Mapping[str, object]:
    """Return a mapping whose keys are all known; raises InputError."""
    found = instance(values, Mapping, name, "a mapping")
    for key in found:
        chosen(key, known, f"{name}: key")
    return found


def refusal(name: str, required: str, value: object) -> InputError:
    """Return the complaint about a value."""
    said = repr(value)
    shown = said if len(said) <= SHOWN else f"{said[:SHOWN]}…"
    return InputError(f"{name}: required {required}, came {type(value).__name__} {shown}")
