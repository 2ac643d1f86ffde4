"""A fleet is identified: equal models whoever works on them, nothing lost, nothing done twice."""

import contextlib
import errno
import gzip
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import fleets
import numpy as np
import pytest
from fleets import MACHINES

import hitchid
from hitchid.errors import InputError, OutputError
from hitchid.fleet import FleetResult, Runner, Store, StoreError, identify_fleet, read_rows
from hitchid.fleet.jobs import IdentificationJob, identification_job
from hitchid.fleet.ledger import load_model, newest
from hitchid.fleet.runners import MAX_DEATHS, check_scheduler, run_local, run_on_cluster
from hitchid.fleet.store import machines_of
from hitchid.fleet.task import UNFINISHED, run_task

ONE = Runner(workers=1)


def job(logs, folder) -> IdentificationJob:
    return identification_job(str(logs), str(folder), fleets.QUICK)


@pytest.mark.parametrize("name", ["..x", ".hidden", "rig\n1", "rig\x1b[31m", "rig\udcff", "rig\u2028"])
def test_an_impossible_name_is_refused_before_any_work(name, logs, tmp_path):
    fleet = tmp_path / "logs"
    shutil.copytree(logs / "tractor-0", fleet / "tractor-0")
    shutil.copytree(logs / "tractor-0", fleet / name)
    with pytest.raises(InputError, match="no machine can be called") as refusal:
        identify_fleet(str(fleet), str(tmp_path / "results"), settings=fleets.QUICK, runner=ONE)
    assert ascii(name) in str(refusal.value)
    assert not (tmp_path / "results").exists()


def test_hidden_folders_without_logs_are_passed_over(logs, tmp_path):
    shutil.copytree(logs / "tractor-0", tmp_path / "rig [1]")
    (tmp_path / ".git").mkdir()
    (tmp_path / ".git" / "HEAD").write_text("ref")
    (tmp_path / "rig [1]" / "._a.csv").write_text("of a file system")
    (machine,) = machines_of(Store(str(tmp_path)))
    assert machine.name == "rig [1]"
    assert len(machine.files) == len(list((logs / "tractor-0").iterdir()))


@pytest.mark.parametrize("run", [run_local, pytest.param(run_on_cluster, marks=pytest.mark.long)])
def test_models_do_not_depend_on_runner_workers_and_order(run, logs, results, tmp_path):
    own = job(logs, tmp_path)
    acknowledgements = list(run(own, machines_of(own.logs)[::-1], 2))
    assert {
        acknowledgement.machine for acknowledgement in acknowledgements if acknowledgement.state == "done"
    } == set(os.listdir(logs))
    assert fleets.model_digests(tmp_path) == fleets.model_digests(results)
    rows = [replace(row, cost=None) for row in read_rows(own.results)]
    assert rows == [replace(row, cost=None) for row in read_rows(Store(str(results)))]


def test_a_row_has_the_figures_of_its_model(logs, results, tmp_path):
    store = Store(str(results))
    row = read_rows(store)[0]
    model = hitchid.load(load_model(store, row, tmp_path))
    assert model.provenance.digest == row.digest
    for direction, figures in row.directions.items():
        channel = model.channels[direction]
        parameters = model.uncertainty[direction].benchmark.parameters
        gain_error = next(estimate.error for estimate in parameters if estimate.name == "gain")
        assert figures.gain == float(channel.benchmark.values[0])
        assert figures.dead_zone == channel.dead_zone
        assert figures.gain_error == pytest.approx(gain_error / figures.gain)
        assert 0 <= figures.correlation <= 1
        # The plant: 30 mm/(s A) behind 0.35 A; a lag of 0.08 s that an integrator lacks takes 3 % of 3 s.
        np.testing.assert_allclose(figures.gain, 30.0, rtol=0.06)
        np.testing.assert_allclose(figures.dead_zone, 0.35, atol=0.01)
        assert figures.tests + 1 == 3  # one in five is held out, at least one
        assert figures.held_out_rmse > 0
    assert row.cost.bytes_read == sum(path.stat().st_size for path in (logs / row.machine).iterdir())
    assert row.cost.core_seconds > 0


def test_a_finished_fleet_is_not_identified_again_unless_settings_differ(logs, results):
    before = {path: path.stat().st_mtime_ns for path in results.rglob("*")}
    result = identify_fleet(str(logs), str(results), settings=fleets.QUICK)
    assert result.worked == 0
    assert len(result.rows) == MACHINES
    assert before == {path: path.stat().st_mtime_ns for path in results.rglob("*")}
    stamps = [
        identification_job("a", "b", {**fleets.QUICK, **more}) for more in ({}, {"seed": 0}, {"seed": 1})
    ]
    assert stamps[0].settings_digest == stamps[1].settings_digest != stamps[2].settings_digest


def test_copied_logs_are_recognised_by_their_content(logs, results, tmp_path):
    """A copy has other times, so that its listing differs; its model is found by the key."""
    copy, own = shutil.copytree(logs, tmp_path / "logs"), shutil.copytree(results, tmp_path / "results")
    for path in copy.rglob("*.csv"):
        os.utime(path, (1e9, 1e9))
    result = identify_fleet(str(copy), str(own), settings=fleets.QUICK, runner=ONE)
    assert result.worked == 0
    assert {row.date for row in result.rows} == {"2001-09-09T01:46:40+00:00"}
    assert fleets.model_digests(own) == fleets.model_digests(results)


def test_bad_campaigns_are_rows_with_their_error(logs, results, tmp_path):
    mixed, own = shutil.copytree(logs, tmp_path / "logs"), shutil.copytree(results, tmp_path / "results")
    (mixed / "empty").mkdir()
    (mixed / "damaged").mkdir()
    packed = gzip.compress((logs / "tractor-0" / "lifting-01.csv").read_bytes())
    (mixed / "damaged" / "lifting-01.csv.gz").write_bytes(packed[: len(packed) // 3])
    (mixed / "wrong").mkdir()
    (mixed / "wrong" / "notes.csv").write_text("who,when\nme,now\n")
    result = identify_fleet(str(mixed), str(own), settings=fleets.QUICK, runner=ONE)
    rows = {row.machine: row for row in result.rows}
    assert {name for name, row in rows.items() if row.state == "failed"} == {"empty", "damaged", "wrong"}
    assert "no log in this folder" in rows["empty"].message
    assert "wrong/notes.csv" in rows["wrong"].message
    assert str(tmp_path) not in rows["wrong"].message
    assert sum(map(len, result.failures.values())) == 3
    assert fleets.model_digests(own) == fleets.model_digests(results)


def test_failures_with_the_same_cause_are_one_group(results):
    (row, *_) = read_rows(Store(str(results)))
    failed = [
        replace(row, machine=f"m{k}", state="failed", message=f"m{k}/log.csv: line {k}: no number")
        for k in range(4)
    ]
    result = FleetResult((*failed, row), 0, {})
    assert result.failures == {"m0/log.csv: line 0: no number": ("m0", "m1", "m2", "m3")}
    assert result.counts == {"failed": 4, "done": 1}


def test_a_full_temporary_folder_makes_no_failure(logs, tmp_path, monkeypatch):
    own = job(logs, tmp_path / "results")
    (machine, *_) = machines_of(own.logs)
    monkeypatch.setattr("hitchid.fleet.task.prepare_worker", lambda: None)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write(*_):
        raise full

    def save(*_):
        raise OutputError(f"{tempfile.gettempdir()}: cannot be written: {full}")

    for name, failing in [("task.download", write), ("jobs.IdentificationJob.work", save)]:
        with monkeypatch.context() as context:
            context.setattr(f"hitchid.fleet.{name}", failing)
            acknowledgement = run_task(own, machine)
        assert acknowledgement.state == UNFINISHED
        assert tempfile.gettempdir() in acknowledgement.message
        assert "No space left on device" in acknowledgement.message
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    assert str(tmp_path / "gone") in run_task(own, machine).message
    assert read_rows(own.results) == ()


def test_results_that_cannot_be_written_are_refused_before_any_work(logs, tmp_path, monkeypatch):
    def write(self, *_):
        raise StoreError(f"{self.url}: read-only")

    monkeypatch.setattr(Store, "write", write)
    monkeypatch.setattr(Runner, "run", lambda *_: pytest.fail("work has begun"))
    with pytest.raises(StoreError, match="results: read-only"):
        identify_fleet(str(logs), str(tmp_path / "results"), settings=fleets.QUICK)


@pytest.mark.long
def test_a_killed_worker_loses_nothing_and_leaves_no_logs(logs, results, tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    own, killed = job(logs, tmp_path / "results"), []
    acknowledgements = []
    for acknowledgement in run_local(own, machines_of(own.logs), 2):
        acknowledgements.append(acknowledgement)
        if not killed:
            killed = multiprocessing.active_children()
            for process in killed:
                os.kill(process.pid, signal.SIGKILL)
    assert killed
    assert sorted(acknowledgement.machine for acknowledgement in acknowledgements) == sorted(os.listdir(logs))
    assert fleets.model_digests(tmp_path / "results") == fleets.model_digests(results)
    assert list(temporary.iterdir()) == []


@pytest.mark.long
def test_a_machine_that_ends_every_worker_is_left_unfinished(logs, tmp_path):
    own = job(logs, tmp_path)
    stop = threading.Event()

    def kill_all():
        while not stop.wait(0.05):
            for process in multiprocessing.active_children():
                process.kill()

    killer = threading.Thread(target=kill_all)
    killer.start()
    (acknowledgement,) = run_local(own, machines_of(own.logs)[:1], 1)
    stop.set()
    killer.join()
    assert acknowledgement.state == UNFINISHED
    assert acknowledgement.message == f"its worker ended {MAX_DEATHS} times: killed, or out of memory"
    assert read_rows(own.results) == ()


@pytest.mark.long
def test_a_killed_run_goes_on_and_leaves_no_process(logs, results, tmp_path):
    def is_running(session):
        """Return whether a process of a session still runs."""
        for path in Path("/proc").glob("[0-9]*/stat"):
            with contextlib.suppress(OSError):  # one that has just ended
                state, _, _, own = path.read_text().rpartition(")")[2].split()[:4]
                if int(own) == session and state != "Z":
                    return True
        return False

    settings = tmp_path / "quick.toml"
    settings.write_text(fleets.QUICK_TOML)
    own = tmp_path / "results"
    command = [sys.executable, "-m", "hitchid", "fleet", "identify", str(logs), "--out", str(own)]
    command += ["--config", str(settings), "--workers", "1"]
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    run = subprocess.Popen(  # noqa: S603
        command,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "TMPDIR": str(temporary)},
    )
    deadline = time.monotonic() + 200
    while not list(own.glob("rows/*/*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    run.kill()
    run.wait()
    done = len(list(own.glob("rows/*/*.json")))
    assert 1 <= done < MACHINES
    while is_running(run.pid):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert not list(temporary.glob("hitchid-fleet-*"))
    second = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)  # noqa: S603
    assert json.loads(second.stdout)["worked"] == MACHINES - done
    assert fleets.model_digests(own) == fleets.model_digests(results)


@pytest.mark.parametrize("limit", [0, 3, 4])
def test_a_store_that_ends_in_mid_write_loses_nothing(limit, logs, tmp_path, monkeypatch):
    """A model has four files, and is none without `model.json`, the last; then its row is written."""
    own = job(logs, tmp_path)
    (machine, *_) = machines_of(own.logs)
    written, write = [], Store.write

    def failing(self, name, content):
        if len(written) == limit:
            raise StoreError("the connection was lost")
        written.append(name)
        write(self, name, content)

    monkeypatch.setattr("hitchid.fleet.task.prepare_worker", lambda: None)
    with monkeypatch.context() as context:
        context.setattr(Store, "write", failing)
        first = run_task(own, machine)
    assert (first.state, first.message) == (UNFINISHED, "the connection was lost")
    assert len(list(tmp_path.glob("models/*/*/model.json"))) == (limit == 4)
    assert read_rows(own.results) == ()
    second = run_task(own, machine)
    assert (second.state, second.worked) == ("done", True)
    assert [row.machine for row in read_rows(own.results)] == [machine.name]


def test_rows_are_compacted_and_the_newest_of_each_machine_counts(results):
    import pandas as pd

    (row, *_) = read_rows(Store(str(results)))
    old, late = replace(row, date="2026-01-01T00:00:00+00:00"), replace(row, date="2026-06-01T00:00:00+00:00")
    assert newest([late, replace(late, state="failed"), old]) == (late,)
    table = pd.read_parquet(results / "fleet.parquet")
    assert list(table["machine"]) == [f"tractor-{k}" for k in range(MACHINES)]
    columns = ["lifting_gain", "bytes_read"]
    pd.testing.assert_frame_equal(table[columns], pd.read_csv(results / "fleet.csv")[columns])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "slurm"}, "runner: .*local or dask"),
        ({"workers": 0}, "workers"),
        ({"name": "dask", "scheduler": "tcp://10.0.0.1:8786"}, "expected tls://"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message, logs, tmp_path):
    with pytest.raises(InputError, match=message):
        identify_fleet(str(logs), str(tmp_path), settings=fleets.QUICK, runner=Runner(**arguments))


def test_stores_without_machines_or_with_results_among_them_are_refused(logs, tmp_path):
    with pytest.raises(InputError, match="one folder for each machine"):
        identify_fleet(str(tmp_path / "logs"), str(tmp_path / "results"))
    for inside in (".", "results"):  # they would be machines of the next run
        with pytest.raises(InputError, match="expected results outside"):
            identify_fleet(str(logs), str(logs / inside), settings=fleets.QUICK)


def test_a_worker_has_its_core_before_numpy_counts_the_cores():
    """Threads of matrix products, which round differently, are as many as the cores at the first import."""
    code = "import sys, hitchid.fleet.runners, hitchid.fleet.task; assert 'numpy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)  # noqa: S603


@pytest.mark.parametrize("address", ["tls://10.0.0.1:8786", "tcp://127.0.0.1:8786", "tcp://localhost:1"])
def test_a_scheduler_is_reached_by_tls_or_on_this_machine(address):
    assert check_scheduler(address) == address
