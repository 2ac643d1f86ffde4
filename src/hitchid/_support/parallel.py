"""Parallel execution of independent tasks on all cores."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from hitchid._support.precision import double_precision

Name = TypeVar("Name")
Result = TypeVar("Result")


def parallel(work: Callable[[Name], Result], names: Iterable[Name]) -> dict[Name, Result]:
    """Run a task for each name, in parallel on all cores and in double precision.

    Threads suffice: JAX compiles and computes without Python's global interpreter lock.

    Args:
        work: the task; an exception is raised after all tasks have ended.
        names: argument of each task.

    Returns:
        Name to result, in the order of the names.
    """
    with ThreadPoolExecutor(max(2, os.cpu_count() or 1)) as executor:
        # JAX's precision is a setting per thread.
        futures = {name: executor.submit(double_precision(work), name) for name in names}
    return {name: future.result() for name, future in futures.items()}
