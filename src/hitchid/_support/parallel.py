"""Independent tasks in parallel, on all cores."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from hitchid._support.precision import double_precision

Name = TypeVar("Name")
Result = TypeVar("Result")


def parallel(work: Callable[[Name], Result], names: Iterable[Name]) -> dict[Name, Result]:
    """Run a task for each of several names, as many at a time as there are cores, in double precision.

    Threads are enough: JAX compiles and computes outside of Python's lock.

    Args:
        work: the task; where one raises, the others are finished first.
        names: argument of each task.

    Returns:
        Name to result, in the order of the names.
    """
    with ThreadPoolExecutor(max(2, os.cpu_count() or 1)) as executor:
        # The precision of JAX is a setting of the thread.
        futures = {name: executor.submit(double_precision(work), name) for name in names}
    return {name: future.result() for name, future in futures.items()}
