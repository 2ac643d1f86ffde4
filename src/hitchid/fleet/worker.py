"""A worker's process: one core of its own, programs kept between machines, memory bounded."""

import os
from contextlib import suppress
from functools import cache
from typing import IO

PROGRAMS_DROPPED_ABOVE = 1 << 30  # bytes of memory; a worker with few programs has half of it (measured)
CORES_FOLDER = "cores"


def prepare_worker() -> None:
    """Give this process one core, and set up JAX for a worker; call it before JAX is imported.

    JAX takes its number of threads from the cores that a process may use, not from any flag: with one core
    the result does not depend on how many workers there are.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # workers share the memory of a GPU
    core = _claimed_core()
    if core is not None:
        for thread in os.listdir("/proc/self/task"):  # those that are started later inherit it
            with suppress(OSError):  # one that has ended
                os.sched_setaffinity(int(thread), {core[0]})
    _prepare_jax()


def bound_memory() -> None:
    """Drop compiled programs where the process has become large; they are read back from the cache."""
    if resident_bytes() > PROGRAMS_DROPPED_ABOVE:
        import gc

        import jax

        jax.clear_caches()
        gc.collect()
        _return_freed_memory()


def _return_freed_memory() -> None:
    """Give memory that was freed back to the system; the C library of Linux keeps it for itself otherwise."""
    import ctypes

    with suppress(OSError, AttributeError):  # another system, or another C library
        ctypes.CDLL(None).malloc_trim(0)


def resident_bytes() -> int:
    """Return the memory that this process uses now; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def peak_bytes() -> int:
    """Return the largest memory that this process has used; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@cache
def _prepare_jax() -> None:
    from hitchid._support.compilation import prepare_jax

    prepare_jax()


@cache
def _claimed_core() -> tuple[int, IO[str] | None] | None:
    """Return a core that no other worker of this user has, with the lock that the process keeps to its end.

    Where all are taken, workers share. None where the system cannot bind threads to cores.
    """
    if not hasattr(os, "sched_getaffinity"):
        return None
    import fcntl

    from hitchid._support.compilation import cache_folder

    cores = sorted(os.sched_getaffinity(0))
    try:
        folder = cache_folder() / CORES_FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        for core in cores:
            lock = open(folder / f"{core}.lock", "w")  # noqa: SIM115 - held until the process ends
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                lock.close()
            else:
                return core, lock
    except OSError:
        pass  # a cache folder that cannot be written
    return cores[os.getpid() % len(cores)], None
