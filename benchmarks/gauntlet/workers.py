"""Runs in processes of their own, so that one that hangs or dies takes no other with it."""

import multiprocessing
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hitchid._support.jax_setup import choose_code_generator
from hitchid.fleet.task import bound_memory

from .outcome import HUNG, TRACEBACK, Outcome

Report = Callable[[Outcome], None]
CACHE = Path("build/gauntlet/compiled")
TIMEOUT_S = 1500.0


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        name: for messages, and of the outcome where there is none.
        work: a function of a module, so that a process can import it; returns an `Outcome`.
        arguments: keyword arguments of it.
        timeout_s: after this it counts as hung.
    """

    name: str
    work: Callable[..., Outcome]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    timeout_s: float = TIMEOUT_S


def run_jobs(jobs: Iterable[Job], report: Report, *, together: int = 0) -> None:
    """Do jobs, one at a time on each core, or `together` at a time without a core of their own.

    What hitchid runs is half Python and half small programs: two runs with one core each end sooner than two
    after each other with both.

    Args:
        jobs: in the order in which they begin.
        report: called with each outcome, from one thread at a time.
        together: processes; 0 pins one to each core.
    """
    prepare_cache()
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    pinned: list[set[int] | None] = [None] * together if together else [{core} for core in cores] or [None]
    waiting: queue.SimpleQueue[Job] = queue.SimpleQueue()
    for job in jobs:
        waiting.put(job)
    lock = threading.Lock()

    def work(core: set[int] | None) -> None:
        worker = _Worker(core)
        while True:
            try:
                job = waiting.get_nowait()
            except queue.Empty:
                worker.close()
                return
            outcome = worker.run(job)
            with lock:
                report(outcome)

    threads = [threading.Thread(target=work, args=(core,)) for core in pinned]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def prepare_cache() -> None:
    """Let all processes compile as the program does, and share compiled programs, the small ones too."""
    choose_code_generator()
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(CACHE.absolute()))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")


class _Worker:
    """A process that does one job after another, begun anew after one that hung or died."""

    def __init__(self, core: set[int] | None):
        self._core = core
        self._process: Any = None
        self._link: Connection | None = None

    def run(self, job: Job) -> Outcome:
        """Return what came of a job."""
        link = self._connection()
        started = time.perf_counter()
        try:
            link.send(job)
            if link.poll(job.timeout_s):
                return link.recv()
        except (EOFError, OSError):
            self.close()
            code = self._process.exitcode
            return _failed_outcome(
                job, TRACEBACK, f"the process ended with code {code}", time.perf_counter() - started
            )
        self._process.kill()
        self.close()
        return _failed_outcome(job, HUNG, f"no answer in {job.timeout_s:.0f} s", job.timeout_s)

    def close(self) -> None:
        """End the process."""
        if self._link is not None:
            self._link.close()
            self._link = None
            self._process.join(5)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()

    def _connection(self) -> Connection:
        if self._link is None:
            # Never fork: JAX runs threads.
            context = multiprocessing.get_context("spawn")
            self._link, child_link = context.Pipe()
            self._process = context.Process(target=_serve, args=(child_link, self._core), daemon=True)
            self._process.start()
            child_link.close()
        return self._link


def _failed_outcome(job: Job, result: str, message: str, seconds: float) -> Outcome:
    return Outcome(
        job.name, result=result, message=message, seconds={"all": seconds}, failures=[f"{result}: {message}"]
    )


def _serve(link: Connection, core: set[int] | None) -> None:
    if core is not None:
        os.sched_setaffinity(0, core)
    while True:
        try:
            job = link.recv()
        except (EOFError, OSError):
            return
        link.send(job.work(**job.arguments))
        # What one run compiled serves the next; a process may map only so many programs into memory.
        bound_memory()
