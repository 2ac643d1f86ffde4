"""Identification of one machine of a fleet."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from hitchid.fleet.ledger import MODEL_FILE, model_name
from hitchid.fleet.row import Row, TaskRow
from hitchid.fleet.task import Job

if TYPE_CHECKING:
    from hitchid.identification import Settings


@dataclass(frozen=True)
class IdentificationJob(Job[Row]):
    """The identification of each machine.

    Attributes:
        logs, results: stores.
        settings: of the identification.
        settings_digest: of settings and versions.
    """

    row_type: ClassVar[type[TaskRow]] = Row
    settings: "Settings"
    settings_digest: str

    def stamp(self, machine: str) -> str:
        """Return the digest of settings and versions, the same for all machines."""
        return self.settings_digest

    def work(self, row: Row, folder: Path) -> tuple[Row, int]:
        """Write the model of the logs in a folder; return the row with its figures, and the bytes written."""
        from hitchid.fleet.estimates import direction_rows
        from hitchid.identification import identify
        from hitchid.model import load
        from hitchid.readers import read

        campaign = read(folder)
        identification = identify(campaign, **self.settings)
        model_folder = folder.with_name(f"{folder.name}.model")
        identification.save(model_folder)
        files = {path.name: path.read_bytes() for path in model_folder.iterdir()}
        self.results.write_folder(model_name(row.machine, row.key), files, last=MODEL_FILE)
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
