"""Validation of one machine of a fleet: its model on new logs, faults, and drift since the identification."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from hitchid._support.storage import canonical_json, digest
from hitchid._support.versions import installed_versions
from hitchid.errors import InputError
from hitchid.fleet.ledger import load_model
from hitchid.fleet.row import DONE, Row, TaskRow, ValidationRow
from hitchid.fleet.store import Store
from hitchid.fleet.task import Job


@dataclass(frozen=True)
class ValidationJob(Job[ValidationRow]):
    """The validation of each machine.

    Attributes:
        logs, results: stores; the logs are those that came after the identification.
        models: store of the results of the identification.
        identified: machine to its row there.
    """

    row_type: ClassVar[type[TaskRow]] = ValidationRow
    models: Store
    identified: Mapping[str, Row]

    def stamp(self, machine: str) -> str:
        """Return a digest of the model and of the versions."""
        row = self.identified.get(machine)
        content = {"model": None if row is None else row.key, "versions": installed_versions()}
        return digest(canonical_json(content))

    def only(self, machine: str) -> "ValidationJob":
        """Return the job with the row of one machine alone."""
        own = {machine: self.identified[machine]} if machine in self.identified else {}
        return replace(self, identified=own)

    def work(self, row: ValidationRow, folder: Path) -> tuple[ValidationRow, int]:
        """Return the row with faults and drift of the logs in a folder."""
        from hitchid.audit import Severity, audit
        from hitchid.fleet.drift import drift_of
        from hitchid.model import load
        from hitchid.readers import read

        identified = self.identified.get(row.machine)
        if identified is None or identified.state != DONE:
            raise InputError(f"{row.machine}: has no model in {self.models.url}; identify it first")
        with tempfile.TemporaryDirectory() as temporary:
            model = load(load_model(self.models, identified, Path(temporary)))
        campaign = read(folder)
        faults = tuple(
            f"{finding.record}: {finding.check}: {finding.what}"
            for finding in audit(campaign)
            if finding.severity is Severity.FAULT
        )
        if not campaign.directions:
            campaign = campaign.segmented(model.dead_zones)
        new = [record for record in campaign.records if record.fingerprint not in model.provenance.seen]
        directions = {}
        for direction, channel in model.channels.items():
            tests = [record for record in new if record.kind == direction]
            if tests:
                directions[direction] = drift_of(channel, tests, identified.directions[direction])
        if not directions:
            raise InputError(f"{row.machine}: has no test that its identification did not use")
        return replace(row, faults=faults, directions=directions, model=identified.key), 0
