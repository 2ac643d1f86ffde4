"""Work on a fleet: the machines that have no row yet, by one of the runners."""

import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic

from hitchid.errors import InputError
from hitchid.fleet.ledger import TABLE_FILE, compact, newest, read_rows, row_name, rows_in
from hitchid.fleet.row import FAILED, OneRow, TaskRow
from hitchid.fleet.runners import run_local, run_on_cluster
from hitchid.fleet.store import Machine, machines_of
from hitchid.fleet.task import UNFINISHED, Acknowledgement, Job

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
    present = rows_in(job.results)
    rows = newest(read_rows(job.results, [name for name in names.values() if name in present], row_type))
    if todo or not job.results.has(TABLE_FILE):
        compact(job.results, rows)
    return FleetResult(rows, worked, unfinished)


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
