"""Double precision within a call and in parallel tasks, independent of the caller's JAX setting."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from typing import ParamSpec, TypeVar

import jax

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Name = TypeVar("Name")


def double_precision(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a function to compute in float64; JAX's setting outside it is unchanged."""

    @wraps(function)
    def wrapper(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with jax.enable_x64(True):
            return function(*args, **kwargs)

    return wrapper


def parallel(work: Callable[[Name], Result], names: Iterable[Name]) -> dict[Name, Result]:
    """Run a task for each name, in parallel on all cores and in double precision; return name to result.

    Threads suffice: JAX compiles and computes without Python's global interpreter lock. An exception is
    raised after all tasks have ended.
    """
    # Two at least: also on one core the directions go on side by side.
    with ThreadPoolExecutor(max(2, os.cpu_count() or 1)) as executor:
        # JAX's precision is a setting per thread.
        futures = {name: executor.submit(double_precision(work), name) for name in names}
    return {name: future.result() for name, future in futures.items()}
