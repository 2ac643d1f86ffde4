"""`validate_fleet`: new logs of each machine against its model."""

from collections.abc import Callable

from hitchid.errors import InputError
from hitchid.fleet.ledger import newest, read_rows
from hitchid.fleet.row import ValidationRow
from hitchid.fleet.run import LOCAL, FleetProgress, FleetResult, Runner, run_fleet
from hitchid.fleet.store import Store
from hitchid.fleet.validate_machine import ValidationJob


def validate_fleet(
    logs: str,
    models: str,
    results: str,
    *,
    runner: Runner = LOCAL,
    progress: Callable[[FleetProgress], None] = lambda update: None,
) -> FleetResult[ValidationRow]:
    """Run new logs of each machine against its model: error in free run, drift, faults of the logs.

    Works, and goes on after a stop, as `identify_fleet`. Tests that the identification used are left out.

    Args:
        logs: folder or URL of a store with one folder of new logs for each machine.
        models: folder or URL of the results of `identify_fleet`.
        results: folder or URL of the store of these results.
        runner: who does the work.
        progress: called before the first machine and after each.

    Raises:
        InputError: the stores cannot be used, or `models` has no models.
        StoreError: a store cannot be listed or written.
    """
    identified = {row.machine: row for row in newest(read_rows(Store(models)))}
    if not identified:
        raise InputError(f"{models}: has no models of a fleet; expected results of `hitchid fleet identify`")
    job = ValidationJob(Store(logs), Store(results), Store(models), identified)
    return run_fleet(job, runner, ValidationRow, progress)


def ranked(rows: tuple[ValidationRow, ...]) -> tuple[ValidationRow, ...]:
    """Return the rows of a validation, those with faults first, then by the p-value of their drift."""
    return tuple(sorted(rows, key=lambda row: (-len(row.faults), row.p_value, row.machine)))
