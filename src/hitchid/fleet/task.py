"""The task of a worker: read the logs of one machine, work on them, write the result and its row."""

import os
import tempfile
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import IO, ClassVar, Generic

from hitchid.errors import HitchError, OutputError
from hitchid.fleet.ledger import ROWS, read_rows, row_name
from hitchid.fleet.row import DONE, FAILED, Cost, OneRow, TaskRow
from hitchid.fleet.store import Machine, Store, content_key, download

# A worker's process: one core of its own, programs kept between machines, memory bounded.

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
        import ctypes
        import gc

        import jax

        jax.clear_caches()
        gc.collect()
        # The C library of Linux keeps freed memory for itself otherwise.
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
    from hitchid._support.jax_setup import prepare_jax

    prepare_jax()


@cache
def _claimed_core() -> tuple[int, IO[str] | None] | None:
    """Return a core that no other worker of this user has, with the lock that the process keeps to its end.

    Where all are taken, workers share. None where the system cannot bind threads to cores.
    """
    if not hasattr(os, "sched_getaffinity"):
        return None
    import fcntl

    from hitchid._support.jax_setup import cache_folder

    cores = sorted(os.sched_getaffinity(0))
    # A lock of the system ends with its process, also with one that is killed; a file would stay.
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


UNFINISHED = "unfinished"  # no row: the store or the worker failed, not the logs


@dataclass(frozen=True)
class Job(ABC, Generic[OneRow]):
    """What is to be done with each machine.

    Attributes:
        logs, results: stores.
    """

    row_type: ClassVar[type[TaskRow]]
    logs: Store
    results: Store

    @abstractmethod
    def stamp(self, machine: str) -> str:
        """Return a digest of all that the outcome of a machine depends on beside its logs."""

    def only(self, machine: str) -> "Job[OneRow]":
        """Return the job with no more than one machine needs, for runners that send it with each machine."""
        return self

    @abstractmethod
    def work(self, row: OneRow, folder: Path) -> tuple[OneRow, int]:
        """Work on the logs in a folder; return the row with what was found, and the bytes written.

        Raises:
            HitchError: the logs cannot be used.
            StoreError: a store cannot be read or written.
        """


@dataclass(frozen=True)
class Acknowledgement:
    """What a worker returns of one machine; everything else is in the store.

    Attributes:
        machine: its name.
        state: `done`, `failed`, or `unfinished` where the row could not be written.
        message: of a failure.
        worked: whether the work was done now, rather than found by its key.
        seconds: of the task, s.
    """

    machine: str
    state: str
    message: str = ""
    worked: bool = True
    seconds: float = 0.0


def run_task(job: Job, machine: Machine) -> Acknowledgement:
    """Work on one machine, and write its result and then its row to the store of results.

    The task may be repeated or run twice at the same time: equal logs give equal files.
    """
    prepare_worker()
    started_s = time.perf_counter()
    try:
        row, worked = _outcome(job, machine)
        # The row after the model: what has a row is done, and is not looked at again.
        job.results.write(row_name(machine.name, row.signature), row.as_json())
    except (OutputError, MemoryError) as error:
        return Acknowledgement(machine.name, UNFINISHED, str(error) or type(error).__name__)
    except OSError as error:  # of this computer, such as a full disk
        reason = f"cannot work in the temporary folder {tempfile.gettempdir()}: {error}"
        return Acknowledgement(machine.name, UNFINISHED, reason)
    # After the row: a worker that ends here has lost nothing.
    bound_memory()
    return Acknowledgement(machine.name, row.state, row.message, worked, time.perf_counter() - started_s)


def _outcome(job: Job, machine: Machine) -> tuple[TaskRow, bool]:
    """Return the row of a machine, and whether the work was done now."""
    started_s, cpu_s = time.perf_counter(), time.process_time()
    stamp = job.stamp(machine.name)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / machine.name
        folder.mkdir()
        contents = download(job.logs, machine.files, folder)
        key, signature = content_key(contents, stamp), machine.signature(stamp)
        # An earlier row from logs with the same content, such as logs that were copied.
        folder_of_rows = f"{ROWS}/{machine.name}"
        names = [f"{folder_of_rows}/{file.name}" for file in job.results.below(folder_of_rows).files()]
        for earlier in read_rows(job.results, names, job.row_type):
            if earlier.key == key:
                return replace(earlier, signature=signature, date=machine.date), False
        row, written = job.row_type(machine.name, key, signature, machine.date, DONE), 0
        try:
            row, written = job.work(row, folder)
        except (OutputError, OSError, MemoryError):
            raise  # not of its logs
        except Exception as error:  # one machine's, which must not end the work on the others
            message = str(error) if isinstance(error, HitchError) else f"{type(error).__name__}: {error}"
            # The temporary folder differs each time, and failures of one cause are one group.
            message = message.replace(f"{temporary}/", "")
            row = replace(row, state=FAILED, cause=type(error).__name__, message=message)
    cost = Cost(
        seconds=time.perf_counter() - started_s,
        core_seconds=time.process_time() - cpu_s,
        bytes_read=machine.size,
        bytes_written=written,
        peak_bytes=peak_bytes(),
    )
    return replace(row, cost=cost), True
