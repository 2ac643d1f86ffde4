"""Work on a fleet: the machines that have no row yet, by processes on this machine or by dask."""

import logging
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Generic, cast
from urllib.parse import urlsplit

from hitchid.errors import InputError, OutputError
from hitchid.fleet.ledger import TABLE_FILE, compact, newest, read_rows, row_name, rows_in
from hitchid.fleet.row import FAILED, OneRow, TaskRow
from hitchid.fleet.store import Machine, machines_of
from hitchid.fleet.task import UNFINISHED, Acknowledgement, Job, prepare_worker, run_task

# Runner on a cluster of dask.distributed, started here or reached by its address.

LOOPBACK = ("127.0.0.1", "::1", "localhost")


def run_on_cluster(
    job: Job,
    machines: Sequence[Machine],
    workers: int,
    scheduler: str | None = None,
    on_page: Callable[[str], None] = lambda address: None,
) -> Iterator[Acknowledgement]:
    """Yield the acknowledgement of each machine, in the order in which they end.

    Where there is no running scheduler, `tls://host:port` or `tcp://` on this machine, one is started with so
    many processes; workers need one thread each. `on_page` is called with the address of dask's own page.

    Raises:
        InputError: dask.distributed is not installed, or the address is neither TLS nor on this machine.
    """
    try:
        from distributed import Client, LocalCluster, as_completed

        from hitchid.fleet.one_core import OneCore
    except ImportError as error:
        raise InputError("dask.distributed is required: pip install 'hitchid[fleet]'") from error

    with ExitStack() as stack:
        target = None if scheduler is None else check_scheduler(scheduler)
        if target is None:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,  # workers bound their memory themselves
                silence_logs=logging.CRITICAL,
            )
            target = stack.enter_context(cluster)
        # Not the default client: the caller's own work with dask must not end up here.
        client = stack.enter_context(Client(target, set_as_default=False))
        client.register_plugin(OneCore())
        on_page(str(client.dashboard_link))
        futures = {
            client.submit(
                partial(run_task, job.only(machine.name)),
                machine,
                key=f"{machine.name}-{machine.signature(job.stamp(machine.name))}",
                pure=False,  # its result is what it writes
            ): machine
            for machine in machines
        }
        for future in as_completed(list(futures), loop=client.loop):
            machine = futures.pop(future)
            error = future.exception()
            yield (
                future.result()
                if error is None
                else Acknowledgement(machine.name, UNFINISHED, f"{type(error).__name__}: {error}")
            )
            future.release()  # or the scheduler keeps all of them to the end


def check_scheduler(address: str) -> str:
    """Return the address of a scheduler that is reached by TLS or on this machine.

    Raises:
        InputError: it is another one: what is sent to a scheduler is run by its workers.
    """
    parts = urlsplit(address)
    if parts.scheme == "tls" or (parts.scheme == "tcp" and parts.hostname in LOOPBACK):
        return address
    raise InputError(
        f"scheduler: got {address}, expected tls://HOST:PORT, or tcp:// with an address of this machine"
    )


REMOVALS = 10  # of a folder that is written meanwhile, until nothing more can be written in it; chosen
KILL = 9  # the signal that ends a process when memory is short; Windows does not name it
MAX_DEATHS = 3  # of workers on one machine, after which it is left unfinished; chosen, as in dask


def run_local(job: Job, machines: Sequence[Machine], workers: int) -> Iterator[Acknowledgement]:
    """Yield the acknowledgement of each machine, in the order in which they end.

    A machine whose worker died is given to another one; after three deaths it is left unfinished.
    """
    # No pool of the standard library: one of its workers that is killed ends them all.
    waiting, deaths = deque(machines), Counter()
    crew: list[_Worker] = []
    try:
        while waiting or any(worker.machine for worker in crew):
            crew += [_Worker.start(job) for _ in range(min(workers, len(waiting)) - len(crew))]
            for worker in crew:
                if worker.machine is None and waiting:
                    worker.give(waiting.popleft())
            # Those that have sent something, or have died.
            ready = wait([worker.connection for worker in crew])
            for worker in [worker for worker in crew if worker.connection in ready]:
                machine, acknowledgement = worker.machine, worker.receive()
                if acknowledgement is None:
                    crew.remove(worker)
                if machine is not None and acknowledgement is None:
                    deaths[machine] += 1
                    if deaths[machine] < MAX_DEATHS:
                        waiting.append(machine)
                        continue
                    message = f"its worker ended {MAX_DEATHS} times: {worker.ending}"
                    acknowledgement = Acknowledgement(machine.name, UNFINISHED, message)
                if acknowledgement is not None:
                    yield acknowledgement
    finally:
        for worker in crew:
            worker.process.kill()
            worker.end()


@dataclass
class _Worker:
    """A process, the connection to it, its temporary folder, and the machine it works on."""

    process: BaseProcess
    connection: Connection
    folder: str
    machine: Machine | None = None

    @classmethod
    def start(cls, job: Job) -> "_Worker":
        context = get_context("spawn")
        ours, theirs = context.Pipe()
        try:
            folder = tempfile.mkdtemp(prefix="hitchid-fleet-")
        except OSError as error:
            raise OutputError(f"no temporary folder can be made: {error}") from error
        # Its folder is known here, so that it is removed though the process was killed.
        process = context.Process(target=_work, args=(theirs, folder), daemon=True)
        process.start()
        theirs.close()  # or the pipe would not end with the process
        worker = cls(process, cast("Connection", ours), folder)
        worker._send(job)
        return worker

    def give(self, machine: Machine) -> None:
        """Let the process work on a machine; a process that has died is noticed when it is waited for."""
        self.machine = machine
        self._send(machine)

    def receive(self) -> Acknowledgement | None:
        """Return what the process sent; None where it has died."""
        self.machine = None
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.end()
            return None

    def end(self) -> None:
        """Wait for a process that ends, and remove what it left in its temporary folder."""
        self.process.join()
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def ending(self) -> str:
        """How the process has ended, in words."""
        code = self.process.exitcode or 0
        if code in (-signal.SIGTERM, -KILL):
            return "killed, or out of memory"
        return f"by signal {-code}" if code < 0 else f"with code {code}, after the error that it wrote"

    def _send(self, value: Job | Machine) -> None:
        with suppress(OSError):
            self.connection.send(value)


def _work(connection: Connection, folder: str) -> None:
    """Work on machines until the connection is closed; logs and models are kept in a folder meanwhile."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all processes of a terminal
    tempfile.tempdir = os.environ["TMPDIR"] = folder
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepare_worker()  # before the settings of the job import JAX
    try:
        job = connection.recv()
        while True:
            connection.send(run_task(job, connection.recv()))
    except (EOFError, OSError):
        return


def _end_with_parent() -> None:
    """End this process when the one that started it has ended."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        for _ in range(REMOVALS):
            shutil.rmtree(tempfile.gettempdir(), ignore_errors=True)
        os._exit(1)


RUNNERS = ("local", "dask")


@dataclass(frozen=True)
class Runner:
    """Who works on a fleet.

    Attributes:
        name: `local` for processes on this machine, `dask` for dask.distributed.
        workers: number of processes; None for one a core.
        scheduler: address of a running dask scheduler; None starts one on this machine.
        on_page: called with the address of the page on which dask shows its work.
    """

    name: str = "local"
    workers: int | None = None
    scheduler: str | None = None
    on_page: Callable[[str], None] = lambda address: None

    def __post_init__(self) -> None:
        """Check the values; raises InputError."""
        if self.name not in RUNNERS:
            raise InputError(f"runner: expected {' or '.join(RUNNERS)}, got {self.name}")
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers: expected at least 1, got {self.workers}")

    def run(self, job: Job, machines: Sequence[Machine]) -> Iterator[Acknowledgement]:
        """Return the acknowledgement of each machine, in the order in which they end."""
        count = min(self.workers or available_cores(), len(machines))
        if not machines:
            return iter(())
        if self.name == "dask":
            return run_on_cluster(job, machines, count, self.scheduler, self.on_page)
        return run_local(job, machines, count)


LOCAL = Runner()


@dataclass(frozen=True)
class FleetProgress:
    """State of the work on a fleet after one machine.

    Attributes:
        last: what was acknowledged last; None before the first.
        finished, total: machines that have ended and all that were missing at the beginning.
        found: machines that had a row before.
        left_s: time left, from the mean of those that have ended, s; None before the first.
    """

    last: Acknowledgement | None
    finished: int
    total: int
    found: int
    left_s: float | None = None


@dataclass(frozen=True)
class FleetResult(Generic[OneRow]):
    """What lies in the store of results after a run.

    Attributes:
        rows: of each machine with a row, by name.
        worked: number of machines that were worked on in this run.
        unfinished: machine to the reason why it has no row; another run tries it again.
    """

    rows: tuple[OneRow, ...]
    worked: int
    unfinished: Mapping[str, str]

    @property
    def counts(self) -> Mapping[str, int]:
        """State to the number of machines in it."""
        return Counter(row.state for row in self.rows)

    @property
    def failures(self) -> Mapping[str, tuple[str, ...]]:
        """Message of a failure to the machines that it ended, the most frequent first.

        Messages that differ only in names and numbers are one; the first is given.
        """
        groups: dict[str, list[TaskRow]] = {}
        for row in self.rows:
            if row.state == FAILED:
                # Without what differs between two machines: the name of a file, and numbers.
                similar = re.sub(r"\d+", "#", re.sub(r"^\S+: ", "", row.message))
                groups.setdefault(similar, []).append(row)
        ordered = sorted(groups.values(), key=len, reverse=True)
        return {rows[0].message: tuple(row.machine for row in rows) for rows in ordered}


def run_fleet(
    job: Job[OneRow], runner: Runner, row_type: type[OneRow], progress: Callable[[FleetProgress], None]
) -> FleetResult[OneRow]:
    """Work on each machine that has no row yet, and compact the rows.

    Raises:
        InputError: a store cannot be used.
        StoreError: a store cannot be listed or written.
    """
    if job.results.is_inside(job.logs):
        raise InputError(
            f"{job.results.url}: is in the store of logs, {job.logs.url}; expected results outside of it"
        )
    machines = machines_of(job.logs)
    # A row has the listing of its logs in its name: what is done is seen without reading a row.
    names = {
        machine: row_name(machine.name, machine.signature(job.stamp(machine.name))) for machine in machines
    }
    before = rows_in(job.results)
    todo = [machine for machine, name in names.items() if name not in before]
    if todo:
        # Before hours of work whose results nobody could keep.
        job.results.check_writable()
    worked, unfinished, started_s = 0, {}, time.monotonic()
    begin = FleetProgress(None, 0, len(todo), len(machines) - len(todo))
    progress(begin)
    for number, last in enumerate(runner.run(job, todo), start=1):
        worked += last.worked and last.state != UNFINISHED
        if last.state == UNFINISHED:
            unfinished[last.machine] = last.message
        left_s = (time.monotonic() - started_s) * (len(todo) - number) / number
        progress(replace(begin, last=last, finished=number, left_s=left_s))
    # Rows as they are in the store now: a second run of the same fleet may have written some of them.
    present = rows_in(job.results)
    rows = newest(read_rows(job.results, [name for name in names.values() if name in present], row_type))
    if todo or not job.results.has(TABLE_FILE):
        compact(job.results, rows)
    return FleetResult(rows, worked, unfinished)


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    # Not all cores: a container or `taskset` may leave fewer.
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
