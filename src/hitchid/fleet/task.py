"""The task of a worker: read the logs of one machine, work on them, write the result and its row."""

import tempfile
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Generic

from hitchid.errors import HitchError, OutputError
from hitchid.fleet.ledger import ROWS, read_rows, row_name
from hitchid.fleet.machines import Machine, content_key
from hitchid.fleet.row import DONE, FAILED, Cost, OneRow, TaskRow
from hitchid.fleet.store import Store, download
from hitchid.fleet.worker import bound_memory, peak_bytes, prepare_worker

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
        job.results.write(row_name(machine.name, row.signature), row.as_json())
    except (OutputError, MemoryError) as error:
        return Acknowledgement(machine.name, UNFINISHED, str(error) or type(error).__name__)
    except OSError as error:  # of this computer, such as a full disk
        reason = f"cannot work in the temporary folder {tempfile.gettempdir()}: {error}"
        return Acknowledgement(machine.name, UNFINISHED, reason)
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
        earlier = _row_with_key(job, machine.name, key)
        if earlier is not None:
            return replace(earlier, signature=signature, date=machine.date), False
        row, written = job.row_type(machine.name, key, signature, machine.date, DONE), 0
        try:
            row, written = job.work(row, folder)
        except (OutputError, OSError, MemoryError):
            raise  # not of its logs
        except Exception as error:  # one machine's, which must not end the work on the others
            message = str(error) if isinstance(error, HitchError) else f"{type(error).__name__}: {error}"
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


def _row_with_key(job: Job, machine: str, key: str) -> TaskRow | None:
    """Return an earlier row of a machine from logs with the same content, such as logs that were copied."""
    folder = f"{ROWS}/{machine}"
    names = [f"{folder}/{file.name}" for file in job.results.below(folder).files()]
    return next((row for row in read_rows(job.results, names, job.row_type) if row.key == key), None)
