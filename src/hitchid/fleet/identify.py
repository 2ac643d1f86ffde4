"""`identify_fleet`: a model of each machine in a store of logs."""

import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from hitchid._support import checks
from hitchid._support.storage import canonical_json, digest
from hitchid.fleet.cluster import run_on_cluster
from hitchid.fleet.ledger import TABLE_FILE, compact, missing, newest, read_rows, row_name, rows_in
from hitchid.fleet.local import run_local
from hitchid.fleet.machines import Machine, machines_of
from hitchid.fleet.row import FAILED, Row
from hitchid.fleet.store import Store
from hitchid.fleet.task import UNFINISHED, Acknowledgement, Job

if TYPE_CHECKING:
    from hitchid.identification import Settings

Run = Callable[[Job, Sequence[Machine], int], Iterator[Acknowledgement]]
RUNNERS = ("local", "dask")


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
class FleetResult:
    """What lies in the store of results after a run.

    Attributes:
        rows: of each machine with a row, by name.
        identified: number of models that were identified in this run.
        unfinished: machine to the reason why it has no row; another run tries it again.
    """

    rows: tuple[Row, ...]
    identified: int
    unfinished: Mapping[str, str]

    @property
    def counts(self) -> Mapping[str, int]:
        """State to the number of machines in it."""
        return Counter(row.state for row in self.rows)

    @property
    def failures(self) -> Mapping[str, tuple[str, ...]]:
        """Cause and message of a failure to the machines that it ended, the most frequent first.

        Messages that differ only in names and numbers are one cause.
        """
        groups: dict[str, list[Row]] = {}
        for row in self.rows:
            if row.state == FAILED:
                groups.setdefault(similar(row.message), []).append(row)
        ordered = sorted(groups.values(), key=len, reverse=True)
        return {rows[0].message: tuple(row.machine for row in rows) for rows in ordered}


def identify_fleet(
    logs: str,
    results: str,
    *,
    settings: "Settings | None" = None,
    runner: str = "local",
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[FleetProgress], None] = lambda update: None,
    on_page: Callable[[str], None] = lambda address: None,
) -> FleetResult:
    """Identify each machine of a store of logs that has no row in the store of results yet.

    A row is written after its model, and each file is written whole, so that the work can be stopped at any
    time and goes on where it was. A campaign that cannot be identified becomes a row with its error.

    Args:
        logs: folder or URL of a store with one folder of logs for each machine.
        results: folder or URL of the store of results.
        settings: of the identification, as for `hitchid.identify`; searches are compared only where set.
        runner: `local` for processes on this machine, `dask` for dask.distributed.
        workers: number of processes, by default one for each core.
        scheduler: address of a running dask scheduler; None starts one on this machine.
        progress: called before the first machine and after each.
        on_page: called with the address of dask's page.

    Raises:
        InputError: the stores, or the settings, cannot be used.
        StoreError: a store cannot be listed or written.
    """
    if runner not in RUNNERS:
        raise checks.input_error("runner", " or ".join(RUNNERS), runner)
    count = available_cores() if workers is None else checks.integer(workers, "workers")
    if count < 1:
        raise checks.input_error("workers", "at least 1", count)
    chosen: Settings = {"comparison": None, **(settings or {})}
    if "structure" in chosen:
        chosen["structure"] = dict(chosen["structure"])  # goes to other processes
    job = Job(Store(logs), Store(results), chosen, job_digest(chosen))
    machines = machines_of(job.logs)
    todo = missing(machines, job.digest, rows_in(job.results))
    on_cluster: Run = partial(run_on_cluster, scheduler=scheduler, on_page=on_page)
    run: Run = on_cluster if runner == "dask" else run_local
    identified, unfinished, started_s = 0, {}, time.monotonic()
    begin = FleetProgress(None, 0, len(todo), len(machines) - len(todo))
    progress(begin)
    acknowledgements = run(job, todo, min(count, len(todo))) if todo else iter(())
    for number, last in enumerate(acknowledgements, start=1):
        identified += last.fitted and last.state != UNFINISHED
        if last.state == UNFINISHED:
            unfinished[last.machine] = last.message
        left_s = (time.monotonic() - started_s) * (len(todo) - number) / number
        progress(replace(begin, last=last, finished=number, left_s=left_s))
    rows = _rows(job, machines, rows_in(job.results))
    if todo or not job.results.has(TABLE_FILE):
        compact(job.results, rows)
    return FleetResult(rows, identified, unfinished)


def similar(message: str) -> str:
    """Return a message without what differs between two machines: the name of a file, and numbers."""
    return re.sub(r"\d+", "#", re.sub(r"^\S+: ", "", message))


def job_digest(settings: "Settings") -> str:
    """Return a digest of settings and versions, on which an identification depends beside the logs.

    Raises:
        InputError: a setting does not fit.
    """
    from hitchid.identification import stamp_of

    return digest(canonical_json(stamp_of(settings)))


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _rows(job: Job, machines: Sequence[Machine], names: frozenset[str]) -> tuple[Row, ...]:
    """Return the rows of the present logs of all machines that have one."""
    wanted = (row_name(machine.name, machine.signature(job.digest)) for machine in machines)
    return newest(read_rows(job.results, [name for name in wanted if name in names]))
