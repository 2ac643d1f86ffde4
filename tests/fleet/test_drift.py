"""Drift: known changes of a plant are found with intervals that hold, none is found where nothing changed."""

from dataclasses import replace

import numpy as np
import pytest

import hitchid
from benches import binary_command, lagged_integrator
from hitchid.errors import InputError
from hitchid.fleet import Runner, Store, ranked, read_rows, validate_fleet
from hitchid.fleet.jobs import ValidationJob, drift_of, fit_change
from hitchid.fleet.ledger import load_model
from hitchid.fleet.store import machines_of
from hitchid.fleet.task import run_task
from hitchid.logs import write_table
from hitchid.logs.record import COMMAND, DISPLACEMENT, Record

GAIN, DEAD_ZONE, NOISE_MM = 30.0, 0.35, 0.02
TESTS = 8


def lifting_tests(gain: float, dead_zone: float, seed: int, scatter: float = 0.01) -> list[Record]:
    """Return lifting tests of a plant whose gain scatters from test to test."""
    rng, records = np.random.default_rng(seed), []
    for number in range(TESTS):
        command = binary_command(rng, 400, 0.45, rng.uniform(0.5, 0.7))
        own = gain * (1 + scatter * rng.standard_normal())
        travel = lagged_integrator(command, gain=own, time_constant=0.08, dead_zone=dead_zone)
        signals = {
            COMMAND["lifting"]: command,
            COMMAND["lowering"]: 0 * command,
            DISPLACEMENT: travel + NOISE_MM * rng.standard_normal(400),
        }
        units = {COMMAND["lifting"]: "A", COMMAND["lowering"]: "A", DISPLACEMENT: "mm"}
        records.append(Record(f"new-{number}", 0.01, signals, units, "lifting"))
    return records


@pytest.fixture
def identified(results, tmp_path):
    """Return the row and the model of one machine."""
    row = read_rows(Store(str(results)))[0]
    return row, hitchid.load(load_model(Store(str(results)), row, tmp_path))


@pytest.mark.parametrize(("factor", "added"), [(1.1, 0.0), (0.9, 0.0), (1.0, 0.03), (1.15, -0.02)])
def test_a_change_of_the_plant_is_found(identified, factor, added):
    row, model = identified
    records = lifting_tests(factor * GAIN, DEAD_ZONE + added, 1)
    drift = drift_of(model.channels["lifting"], records, row.directions["lifting"])
    # Four standard errors: one in 16 000 misses by more.
    assert abs(drift.gain_change - (factor - 1)) < 4 * drift.gain_change_error
    assert abs(drift.dead_zone_change - added) < 4 * drift.dead_zone_change_error
    assert drift.gain_change_error < 0.1
    assert drift.p_value < 0.01
    assert drift.rmse > drift.reference_rmse
    assert drift.tests == TESTS


def test_errors_and_p_values_hold_where_nothing_changed(identified):
    """The new tests' own errors: Hotelling's test at 10 % rejects about that share of 40 sets of tests."""
    _, model = identified
    channel = model.channels["lifting"]
    many = [record for seed in range(100, 108) for record in lifting_tests(GAIN, DEAD_ZONE, seed)]
    reference = fit_change(channel, many)
    rejected = 0
    for seed in range(40):
        change = fit_change(channel, lifting_tests(GAIN, DEAD_ZONE, seed))
        theta, covariance = change.theta - reference.theta, change.covariance + reference.covariance
        statistic = theta @ np.linalg.solve(covariance, theta)
        rejected += statistic * (TESTS - 2) / (2 * (TESTS - 1)) > 3.463  # F(2, 6) at 10 %
    # Binomial(40, 0.1): 0 to 11 with a probability of 99.9 %; few clusters make the covariance too small.
    assert rejected <= 11


def test_a_dead_zone_that_the_commands_do_not_determine_stays(identified):
    """At one level of the command gain and dead zone have the same effect: the prior divides it."""
    _, model = identified
    command = np.where(np.arange(400) < 5, 0.0, 0.6)
    one_level = []
    for record in lifting_tests(GAIN, DEAD_ZONE, 3):
        travel = lagged_integrator(command, gain=1.1 * GAIN, time_constant=0.08, dead_zone=DEAD_ZONE)
        signals = {**record.signals, COMMAND["lifting"]: command, DISPLACEMENT: travel}
        one_level.append(replace(record, signals=signals))
    change = fit_change(model.channels["lifting"], one_level)
    assert np.all(np.isfinite(change.covariance))
    assert abs(change.theta[1]) < 0.1


def test_few_tests_give_no_change(identified):
    """Three tests do not tell a change from the scatter between tests."""
    row, model = identified
    records = lifting_tests(1.3 * GAIN, DEAD_ZONE, 4)[:3]
    drift = drift_of(model.channels["lifting"], records, row.directions["lifting"])
    assert drift.gain_change is None
    assert drift.p_value is None
    assert drift.rmse > drift.reference_rmse


def test_fleet_validate_ranks_the_machine_that_changed(identified, results, tmp_path):
    row, _ = identified
    new = tmp_path / "new"
    for name, gain in (("tractor-0", 1.2 * GAIN), ("unknown", GAIN)):
        folder = new / name
        folder.mkdir(parents=True)
        for record in lifting_tests(gain, DEAD_ZONE, 5):
            columns = {
                "time_s": np.round(0.01 * np.arange(400), 4),
                "current_up_A": record.command("lifting"),
                "current_down_A": record.command("lowering"),
                "displacement_mm": record.displacement,
            }
            write_table(folder / f"{record.name}.csv", columns)
    result = validate_fleet(str(new), str(results), str(tmp_path / "out"), runner=Runner(workers=1))
    by_name = {validation.machine: validation for validation in result.rows}
    changed = by_name["tractor-0"]
    assert changed.directions["lifting"].gain_change == pytest.approx(0.2, abs=0.05)
    assert changed.model == row.key
    assert by_name["unknown"].state == "failed"
    assert "has no model" in by_name["unknown"].message
    assert [validation.machine for validation in ranked(result.rows)] == ["tractor-0", "unknown"]
    again = validate_fleet(str(new), str(results), str(tmp_path / "out"))
    assert again.worked == 0
    assert again.rows == result.rows


@pytest.mark.long
def test_tests_of_the_identification_are_left_out(identified, logs, results, tmp_path, monkeypatch):
    row, _ = identified
    monkeypatch.setattr("hitchid.fleet.task.prepare_worker", lambda: None)
    job = ValidationJob(
        Store(str(logs)), Store(str(tmp_path / "out")), Store(str(results)), {row.machine: row}
    )
    run_task(job, machines_of(job.logs)[0])
    (validation,) = read_rows(job.results, row_type=type(job).row_type)
    assert {drift.tests for drift in validation.directions.values()} == {1}  # the one that was held out


def test_a_store_without_models_is_refused(tmp_path):
    with pytest.raises(InputError, match="has no models of a fleet"):
        validate_fleet(str(tmp_path), str(tmp_path), str(tmp_path / "out"))
