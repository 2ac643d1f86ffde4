"""The task of a worker: read the logs of one machine, identify, write model and row."""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hitchid.errors import HitchError
from hitchid.fleet.ledger import MODEL_FILE, ROWS, model_name, read_rows, row_name
from hitchid.fleet.machines import Machine, content_key
from hitchid.fleet.row import DONE, FAILED, Cost, Row
from hitchid.fleet.store import Store, StoreError, download
from hitchid.fleet.worker import bound_memory, peak_bytes, prepare_worker

if TYPE_CHECKING:
    from hitchid.identification import Settings

UNFINISHED = "unfinished"  # no row: the store or the worker failed, not the campaign


@dataclass(frozen=True)
class Job:
    """What is to be done with each machine.

    Attributes:
        logs, results: stores.
        settings: of the identification.
        digest: of settings and versions.
    """

    logs: Store
    results: Store
    settings: "Settings"
    digest: str


@dataclass(frozen=True)
class Acknowledgement:
    """What a worker returns of one machine; everything else is in the store.

    Attributes:
        machine: its name.
        state: `done`, `failed`, or `unfinished` where the row could not be written.
        message: of a failure.
        fitted: whether a model was identified now, rather than found by its key.
        seconds: of the task, s.
    """

    machine: str
    state: str
    message: str = ""
    fitted: bool = True
    seconds: float = 0.0


def identify_machine(job: Job, machine: Machine) -> Acknowledgement:
    """Identify one machine, and write its model and then its row to the store of results.

    The task may be repeated or run twice at the same time: equal logs give equal files.
    """
    prepare_worker()
    started_s = time.perf_counter()
    try:
        row, fitted = _outcome(job, machine)
        job.results.write(row_name(machine.name, row.signature), row.as_json())
    except (StoreError, MemoryError) as error:
        return Acknowledgement(machine.name, UNFINISHED, str(error) or type(error).__name__)
    bound_memory()
    return Acknowledgement(machine.name, row.state, row.message, fitted, time.perf_counter() - started_s)


def _outcome(job: Job, machine: Machine) -> tuple[Row, bool]:
    """Return the row of a machine, and whether it was identified now."""
    started_s, cpu_s = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / Path(machine.name).name
        folder.mkdir()
        contents = download(job.logs, machine.files, folder)
        key, signature = content_key(contents, job.digest), machine.signature(job.digest)
        earlier = _row_with_key(job.results, machine.name, key)
        if earlier is not None:
            return replace(earlier, signature=signature, date=machine.date), False
        row = Row(machine.name, key, signature, machine.date, DONE)
        try:
            row, written = _identified(job, row, folder)
        except (StoreError, MemoryError):
            raise
        except Exception as error:  # one machine's, which must not end the work on the others
            message = str(error) if isinstance(error, HitchError) else f"{type(error).__name__}: {error}"
            message = message.replace(f"{temporary}/", "")
            row, written = replace(row, state=FAILED, cause=type(error).__name__, message=message), 0
    cost = Cost(
        seconds=time.perf_counter() - started_s,
        core_seconds=time.process_time() - cpu_s,
        bytes_read=machine.size,
        bytes_written=written,
        peak_bytes=peak_bytes(),
    )
    return replace(row, cost=cost), True


def _row_with_key(results: Store, machine: str, key: str) -> Row | None:
    """Return an earlier row of a machine from logs with the same content, such as logs that were copied."""
    folder = f"{ROWS}/{machine}"
    files = Store(f"{results.url.rstrip('/')}/{folder}").files()
    names = [f"{folder}/{file.name}" for file in files if "/" not in file.name]
    return next((row for row in read_rows(results, names) if row.key == key), None)


def _identified(job: Job, row: Row, folder: Path) -> tuple[Row, int]:
    """Return the row with the figures of the identified model, which is written, and the bytes written."""
    from hitchid.fleet.estimates import direction_rows
    from hitchid.identification import identify
    from hitchid.model import load
    from hitchid.readers import read

    campaign = read(folder)
    identification = identify(campaign, **job.settings)
    model_folder = folder.with_name("model")
    identification.save(model_folder)
    files = {path.name: path.read_bytes() for path in model_folder.iterdir()}
    job.results.write_folder(model_name(row.machine, row.key), files, last=MODEL_FILE)
    notices = tuple(
        f"{direction}: {notice}"
        for direction, trace in identification.channels.items()
        for notice in trace.notices
    )
    found = replace(
        row,
        digest=load(model_folder).provenance.digest,
        units=dict(identification.model.units),
        directions=direction_rows(identification, campaign),
        notices=notices,
    )
    return found, sum(map(len, files.values()))
