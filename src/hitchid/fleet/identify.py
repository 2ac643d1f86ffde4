"""`identify_fleet`: a model of each machine in a store of logs."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from hitchid._support.storage import canonical_json, digest
from hitchid.fleet.identify_machine import IdentificationJob
from hitchid.fleet.row import Row
from hitchid.fleet.run import LOCAL, FleetProgress, FleetResult, Runner, run_fleet
from hitchid.fleet.store import Store

if TYPE_CHECKING:
    from hitchid.identification import Settings


def identify_fleet(
    logs: str,
    results: str,
    *,
    settings: "Settings | None" = None,
    runner: Runner = LOCAL,
    progress: Callable[[FleetProgress], None] = lambda update: None,
) -> FleetResult[Row]:
    """Identify each machine of a store of logs that has no row in the store of results yet.

    A row is written after its model, and each file is written whole, so that the work can be stopped at any
    time and goes on where it was. A campaign that cannot be identified becomes a row with its error.

    Args:
        logs: folder or URL of a store with one folder of logs for each machine.
        results: folder or URL of the store of results.
        settings: of the identification, as for `hitchid.identify`; searches are compared only where set.
        runner: who does the work.
        progress: called before the first machine and after each.

    Raises:
        InputError: the stores, or the settings, cannot be used.
        StoreError: a store cannot be listed or written.
    """
    return run_fleet(identification_job(logs, results, settings or {}), runner, Row, progress)


def identification_job(logs: str, results: str, settings: "Settings") -> IdentificationJob:
    """Return the job of an identification with settings that are checked.

    Raises:
        InputError: a setting does not fit.
    """
    from hitchid.identification import Settings, stamp_of

    chosen: Settings = {"rivals": None, **settings}
    if "structure" in chosen:
        chosen["structure"] = dict(chosen["structure"])  # goes to other processes
    return IdentificationJob(Store(logs), Store(results), chosen, digest(canonical_json(stamp_of(chosen))))
