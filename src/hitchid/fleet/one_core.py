"""Plugin of a dask worker: a core of its own before it receives a machine with the settings.

It stands in a file of its own, so that dask finds it by its name, and the library is imported with it alone.
"""

import tempfile

from distributed import Worker, WorkerPlugin

from hitchid.fleet.task import prepare_worker


class OneCore(WorkerPlugin):
    """Gives each worker its core when it starts, and the folder that dask removes though it is killed."""

    def setup(self, worker: Worker) -> None:
        """Prepare the process of a worker."""
        tempfile.tempdir = worker.local_directory
        prepare_worker()
