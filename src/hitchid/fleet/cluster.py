"""Runner on a cluster of dask.distributed, started here or reached by its address."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from hitchid.errors import InputError
from hitchid.fleet.machines import Machine
from hitchid.fleet.task import UNFINISHED, Acknowledgement, Job, run_task

if TYPE_CHECKING:
    from distributed import Client

LOOPBACK = ("127.0.0.1", "::1", "localhost")


def run_on_cluster(
    job: Job,
    machines: Sequence[Machine],
    workers: int,
    scheduler: str | None = None,
    on_page: Callable[[str], None] = lambda address: None,
) -> Iterator[Acknowledgement]:
    """Yield the acknowledgement of each machine, in the order in which they end.

    Args:
        job: what is to be done.
        machines: to work on.
        workers: number of processes of one thread, where the cluster is started here.
        scheduler: address of a running scheduler, `tls://host:port`, or `tcp://` on this machine; its workers
            need one thread each.
        on_page: called with the address of the page on which dask shows its work.

    Raises:
        InputError: dask.distributed is not installed, or the address is neither TLS nor on this machine.
    """
    try:
        from distributed import as_completed

        from hitchid.fleet.one_core import OneCore
    except ImportError as error:
        raise InputError("dask.distributed is required: pip install 'hitchid[fleet]'") from error
    with _client(workers, scheduler) as client:
        client.register_plugin(OneCore())
        on_page(str(client.dashboard_link))
        futures = {
            client.submit(
                partial(run_task, job.only(machine.name)),
                machine,
                key=f"{machine.name}-{machine.signature(job.stamp(machine.name))}",
                pure=False,
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
            future.release()


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


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator["Client"]:
    from distributed import Client, LocalCluster

    if scheduler is not None:
        with Client(check_scheduler(scheduler), set_as_default=False) as client:
            yield client
        return
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=0,  # workers bound their memory themselves
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client
