"""Works that do not wait for each other, on all cores at the same time."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from hitchid._support.precision import double_precision

Name = TypeVar("Name")
Result = TypeVar("Result")


def parallel(work: Callable[[Name], Result], names: Iterable[Name]) -> dict[Name, Result]:
    """Do a work for each of several names, as many at a time as there are cores, in double precision.

    Threads are enough: JAX compiles and computes outside of Python's lock.

    Args:
        work: what is done; where it raises, the others are finished first.
        names: for what.

    Returns:
        Name to what came of it, in the order of the names.
    """
    with ThreadPoolExecutor(max(2, os.cpu_count() or 1)) as executor:
        # JAX knows its precision thread by thread.
        futures = {name: executor.submit(double_precision(work), name) for name in names}
    return {name: future.result() for name, future in futures.items()}
