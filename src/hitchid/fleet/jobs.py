"""`identify_fleet`: a model of each machine in a store of logs."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import f as f_distribution

from hitchid._support.files import canonical_json, digest
from hitchid._support.jax_setup import installed_versions
from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.fleet.ledger import MODEL_FILE, load_model, model_name, newest, read_rows
from hitchid.fleet.row import DONE, DirectionRow, DriftRow, Row, TaskRow, ValidationRow
from hitchid.fleet.runners import LOCAL, FleetProgress, FleetResult, Runner, run_fleet
from hitchid.fleet.store import Store
from hitchid.fleet.task import Job
from hitchid.live.parameters import changed_benchmark
from hitchid.logs import Record
from hitchid.model import Channel

if TYPE_CHECKING:
    from hitchid.identification import Settings


# Identification of one machine of a fleet.


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
        from hitchid.logs import read
        from hitchid.model import load

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
        identified = replace(
            row,
            digest=load(model_folder).provenance.digest,
            units=dict(identification.model.units),
            directions=direction_rows(identification, campaign),
            notices=notices,
        )
        return identified, sum(map(len, files.values()))


# Validation of one machine of a fleet: its model on new logs, faults, and drift since the identification.


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
        # A model that was identified again asks for another validation of the same logs.
        content = {"model": None if row is None else row.key, "versions": installed_versions()}
        return digest(canonical_json(content))

    def only(self, machine: str) -> "ValidationJob":
        """Return the job with the row of one machine alone."""
        own = {machine: self.identified[machine]} if machine in self.identified else {}
        return replace(self, identified=own)

    def work(self, row: ValidationRow, folder: Path) -> tuple[ValidationRow, int]:
        """Return the row with faults and drift of the logs in a folder."""
        from hitchid._support.records import Severity
        from hitchid.logs import from_rest, read
        from hitchid.logs.audit import audit
        from hitchid.model import load

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
        # As identification takes them: its errors in free run begin at rest.
        campaign, _ = from_rest(campaign)
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


# `validate_fleet`: new logs of each machine against its model.


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


# Drift of a machine: how gain and dead zone have changed between its identification and new logs.
#
# In free run over the new tests, θ = (Δ ln gain, Δ dead zone) is fitted to the errors e by Gauss–Newton steps
#
#     θ ← θ + (JᵀJ + P)⁻¹ (Jᵀe − P θ),   J = ∂ŷ/∂θ,   P = s² diag(1/σ²),
#
# where the weak prior σ keeps a parameter at zero that the commands do not determine. Tests are independent,
# the samples of one are not: the covariance is H⁻¹ Σ gₜ gₜᵀ H⁻¹ T/(T − 2), H = JᵀJ + P, gₜ = Jₜᵀeₜ.

Errors = Callable[[np.ndarray], np.ndarray]
"""θ to the errors of all tests, shape [2] to [T, N]."""
STEPS = 6  # Gauss-Newton steps; changes of 50 % converge to 1e-6 in five
PRIOR_GAIN, PRIOR_DEAD_ZONE = 0.5, 0.3  # σ of ln gain, and of the dead zone as share of the largest command
DIFFERENCE = 1e-3  # of ln gain, and of the dead zone as share of the largest command: derivatives to 1e-6
PARAMETERS = 2
MIN_TESTS = 4  # clusters from which a covariance of two parameters and Hotelling's test exist, T ≥ 2 p


class Change(NamedTuple):
    """Fitted θ with the covariance of its error, shape [2] and [2, 2]."""

    theta: np.ndarray
    covariance: np.ndarray


def drift_of(channel: Channel, records: Sequence[Record], identified: DirectionRow) -> DriftRow:
    """Return the change of one direction between its identification and new tests."""
    batch = channel.batch(records)
    mask = np.asarray(batch.loss_mask & batch.valid)
    errors = (np.asarray(batch.displacement) - np.asarray(channel.simulate(batch)))[mask]
    rmse, before = float(np.sqrt(np.mean(errors**2))), identified.held_out_rmse or identified.rmse
    tests = len(records)
    # Few tests do not tell a change from the scatter between them; the error in free run they do.
    unchanged = DriftRow(None, None, None, None, None, rmse, before, tests)
    if tests < MIN_TESTS:
        return unchanged
    theta, covariance = fit_change(channel, records)
    errors = np.array([identified.gain_error or 0.0, identified.dead_zone_error])
    correlation = np.array([[1.0, identified.correlation], [identified.correlation, 1.0]])
    # What the identification did not know of its own parameters is no drift.
    covariance = covariance + np.outer(errors, errors) * correlation
    deviations = np.sqrt(np.diag(covariance))
    p_value = None
    if identified.gain_error is not None:  # Hotelling's T² with tests − 1 degrees of freedom
        statistic, below = float(theta @ np.linalg.pinv(covariance) @ theta), tests - PARAMETERS
        ratio = statistic * below / (PARAMETERS * (tests - 1))
        p_value = float(f_distribution.sf(ratio, PARAMETERS, below))
    return replace(
        unchanged,
        gain_change=float(np.expm1(theta[0])),
        gain_change_error=float(np.exp(theta[0]) * deviations[0]),
        dead_zone_change=float(theta[1]),
        dead_zone_change_error=float(deviations[1]),
        p_value=p_value,
    )


@double_precision
def fit_change(channel: Channel, records: Sequence[Record]) -> Change:
    """Fit the change of ln gain and dead zone to the free runs over at least three tests."""
    batch = channel.batch(records)
    mask = np.asarray(batch.loss_mask & batch.valid)
    largest = float(np.max(np.abs(np.where(mask, np.asarray(batch.raw_command), 0.0))))
    scale = np.array([1.0, largest])

    def errors_at(theta: np.ndarray) -> np.ndarray:
        changes = jnp.array([theta[0], theta[1], 0.0])
        changed = replace(channel, benchmark=changed_benchmark(channel.benchmark, changes))
        shifted = batch.with_dead_zones(batch.dead_zone + theta[1])
        return np.where(mask, np.asarray(batch.displacement) - np.asarray(changed.simulate(shifted)), 0.0)

    prior = 1 / (np.array([PRIOR_GAIN, PRIOR_DEAD_ZONE]) * scale) ** 2
    theta = np.zeros(PARAMETERS)
    for _ in range(STEPS):
        theta = theta + _step(errors_at, theta, prior, scale)[0]
    # Once more at the solution: the covariance is that of its derivatives, not of those a step before.
    _, normal, scores = _step(errors_at, theta, prior, scale)
    inverse, tests = np.linalg.inv(normal), len(records)
    return Change(theta, tests / (tests - PARAMETERS) * inverse @ scores.T @ scores @ inverse)


def _step(
    errors_at: Errors, theta: np.ndarray, prior: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a Gauss-Newton step [2], JᵀJ + P [2, 2], and the score of each test [T, 2]."""
    errors = errors_at(theta)
    # ∂ŷ/∂θ by central differences, shape [2, T, N]
    steps = np.diag(DIFFERENCE * scale)
    slopes = np.stack([(errors_at(theta - d) - errors_at(theta + d)) / (2 * np.max(d)) for d in steps])
    weight = np.diag(prior * np.sum(errors**2) / max(np.count_nonzero(errors), 1))
    normal = np.einsum("ptn,qtn->pq", slopes, slopes) + weight
    scores = np.einsum("ptn,tn->tp", slopes, errors)
    return np.linalg.solve(normal, scores.sum(axis=0) - weight @ theta), normal, scores


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

    # Rivals take longer than the model, and a fleet compares machines, not methods.
    chosen: Settings = {"rivals": None, **settings}
    if "structure" in chosen:
        chosen["structure"] = dict(chosen["structure"])  # goes to other processes
    return IdentificationJob(Store(logs), Store(results), chosen, digest(canonical_json(stamp_of(chosen))))
