"""Checks of arguments of public functions; errors name the argument, the requirement and the value."""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from numbers import Integral
from pathlib import Path
from typing import ParamSpec, TypeVar

import numpy as np

from hitchid._support.screen import shortened
from hitchid.errors import InputError

Kind = TypeVar("Kind")
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
MAX_SHOWN = 60  # characters of a value in a message (chosen)


def instance(value: object, kind: type[Kind] | tuple[type[Kind], ...], name: str, required: str) -> Kind:
    """Return a value of a given type, or of one of several; `required` says which in the message.

    Raises:
        InputError: the value is of another type.
    """
    if not isinstance(value, kind):
        raise input_error(name, required, value)
    return value


def named_arguments(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a public function: a call with arguments that it does not take names those that it takes.

    Raises:
        InputError: an argument is missing, given twice, or has a name that is not known.
    """

    @wraps(function)
    def wrapper(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        try:
            return function(*args, **kwargs)
        except TypeError:
            # Only arguments that do not fit: a TypeError from within the function stays what it is.
            signature = inspect.signature(function)
            try:
                signature.bind(*args, **kwargs)
            except TypeError as error:
                parameters = ", ".join(name for name in signature.parameters if name != "self")
                message = f"{function.__name__}: {error}; expected arguments {parameters}"
                raise InputError(message) from None
            raise

    return wrapper


def number(value: object, name: str, *, above: float = -math.inf) -> float:
    """Return a finite real number; NumPy and JAX scalars are converted.

    Raises:
        InputError: the value is no finite number, or not larger than `above`.
    """
    required = f"a finite number above {above:g}" if above > -math.inf else "a finite number"
    values = array(value, name, required, "a number")
    if values.shape != () or not above < float(values) < math.inf:
        raise input_error(name, required, value)
    return float(values)


def array(value: object, name: str, required: str, readable: str = "") -> np.ndarray:
    """Return integers or real numbers as an array; raises `InputError` for anything else.

    `readable` names what is required of a value of which NumPy makes no array; `required` by default.
    """
    try:
        values = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise input_error(name, readable or required, value) from error
    if values.dtype.kind not in "iuf":
        raise input_error(name, required, value)
    return values


def numbers(value: object, name: str) -> np.ndarray:
    """Return finite real numbers as an array of any shape; raises `InputError` for anything else."""
    values = array(value, name, "finite numbers", "numbers")
    if not np.all(np.isfinite(values)):
        raise input_error(name, "finite numbers", value)
    return values.astype(float)


def integer(value: object, name: str, *, minimum: int = 0) -> int:
    """Return an integer of at least `minimum`; raises `InputError` for any other value."""
    # A truth value is an integer to Python, and no count to a user.
    if isinstance(value, bool) or not isinstance(value, Integral) or value < minimum:
        raise input_error(name, f"a whole number of at least {minimum}", value)
    return int(value)


def one_of(value: object, allowed: Iterable[str], name: str) -> str:
    """Return one of the allowed names; raises `InputError` for any other value."""
    names = tuple(allowed)
    if not isinstance(value, str) or value not in names:
        raise input_error(name, f"one of {', '.join(names)}", value)
    return value


def path(value: object, name: str) -> Path:
    """Return a path; raises `InputError` for any value other than a string or a path."""
    return Path(instance(value, (str, Path), name, "a path"))


def tuple_of(
    values: object, kind: type[Kind] | tuple[type[Kind], ...], name: str, required: str
) -> tuple[Kind, ...]:
    """Return the items of an iterable of one type; raises `InputError` for strings and mappings."""
    if isinstance(values, str | bytes | Mapping) or not isinstance(values, Iterable):
        raise input_error(name, required, values)
    if getattr(values, "ndim", 1) == 0:  # an array without axes, which no loop can take
        raise input_error(name, required, values)
    return tuple(instance(value, kind, name, required) for value in values)


def mapping_of(values: object, allowed: Iterable[str], name: str) -> Mapping[str, object]:
    """Return a mapping with allowed keys only; raises `InputError` for any other value."""
    mapping = instance(values, Mapping, name, "a mapping")
    for key in mapping:
        one_of(key, allowed, f"{name}: key")
    return mapping


def input_error(name: str, required: str, value: object) -> InputError:
    """Return the error for a value that does not meet a requirement."""
    shown = shortened(repr(value), MAX_SHOWN)
    return InputError(f"{name}: expected {required}, got {type(value).__name__} {shown}")
