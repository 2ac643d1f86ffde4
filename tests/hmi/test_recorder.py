"""A log holds every sample once and whole lines only, also when its writer is killed or the disk is full."""

import errno
import os
import re
import resource
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_bench import STEP_S, DiskAtOnce, Plant
from hitchid.errors import OutputError
from hitchid.hmi import recorder
from hitchid.hmi.disk import Disk
from hitchid.hmi.recorder import DIGITS, FLUSH_S, Recorder
from hitchid.hmi.source import Reading

HEADER = "time_s,current_up_A,current_down_A,displacement_mm"
WRITER = """
import itertools, sys, time
from pathlib import Path
from fake_bench import STEP_S, DiskAtOnce, Plant
from hitchid.hmi.recorder import Recorder
from hitchid.hmi.source import Reading

log = Recorder(Path(sys.argv[1]), "log.csv", Plant.signals, DiskAtOnce())
for k in itertools.count():
    log.append([Reading(k * STEP_S, (0.1, 0.0, 100.0 + k))])
    print(k, flush=True)
    time.sleep(0.001)
"""


def lines_of(path):
    header, *lines = path.read_text().splitlines()
    return header, lines


def recorder_in(folder, disk=None):
    return Recorder(folder, "log.csv", Plant.signals, disk or DiskAtOnce())


@given(
    st.integers(0, 10**6),
    st.lists(st.integers(0, 7), max_size=40),
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
)
def test_every_sample_is_there_once(tmp_path_factory, begin, sizes, values):
    folder, sample = tmp_path_factory.mktemp("log"), begin
    log = recorder_in(folder)
    for size in sizes:
        log.append([Reading(STEP_S * (sample + k), tuple(values)) for k in range(size)])
        sample += size
    log.close()
    lines = lines_of(folder / "log.csv")[1]
    assert len(lines) == log.samples == sum(sizes)
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines]).reshape(-1, 4)
    # Times of up to 10⁴ s carry a rounding of 1e-12 s, and are written with ten digits from zero on.
    np.testing.assert_allclose(rows[:, 0], STEP_S * np.arange(len(rows)), atol=1e-10, rtol=10.0**-DIGITS)
    np.testing.assert_allclose(rows[:, 1:], np.tile(values, (len(rows), 1)), rtol=10.0 ** (1 - DIGITS))


def test_the_columns_are_those_of_the_command_line(tmp_path):
    log = recorder_in(tmp_path)
    log.append([Reading(3.0, (0.5, float("nan"), float("nan")))])
    log.close()
    assert lines_of(tmp_path / "log.csv") == (HEADER, ["0,0.5,,"])


def test_a_log_that_exists_or_finds_no_room_is_refused(tmp_path, monkeypatch):
    (tmp_path / "mine.csv").write_text("mine")
    assert refusal(tmp_path, "mine.csv") == "mine.csv: exists already; choose another name"
    assert (tmp_path / "mine.csv").read_text() == "mine"

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(recorder.os, "write", full)
    assert "No space left on device" in refusal(tmp_path, "log.csv")
    assert not (tmp_path / "log.csv").exists()  # an empty log would take its name


def refusal(root, path):
    """Return why a log is not written; its samples are handed over all the same."""
    disk = DiskAtOnce()
    log = Recorder(root, path, Plant.signals, disk)
    log.append([Reading(0.0, (0.0, 0.0, 1.0))])
    log.close()
    with pytest.raises(OutputError) as raised:
        disk.check()
    disk.check()  # once only
    return str(raised.value)


@pytest.mark.parametrize("path", ["log.csv", "logs/log.csv", "campaigns/monday/log.csv"])
def test_no_log_is_written_to_where_a_link_leads(tmp_path, path):
    root, elsewhere = tmp_path / "project", tmp_path / "elsewhere"
    root.mkdir()
    elsewhere.mkdir()
    first = path.partition("/")[0]
    (root / first).symlink_to(elsewhere / "log.csv" if first == path else elsewhere)
    assert re.search("exists already|is a link; expected a folder of the project", refusal(root, path))
    assert list(elsewhere.iterdir()) == []


def test_a_killed_writer_leaves_whole_lines_until_shortly_before(tmp_path):
    path = tmp_path / "log.csv"
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as writer:  # noqa: S603
        samples = [int(writer.stdout.readline()) for _ in range(150)]
        os.kill(writer.pid, signal.SIGKILL)
        samples += list(map(int, writer.stdout.read().split(b"\n")[:-1]))
    assert path.read_bytes().endswith(b"\n")
    header, lines = lines_of(path)
    assert header == HEADER
    assert [line.split(",")[3] for line in lines] == [str(100 + k) for k in range(len(lines))]
    # One more sample may have been appended and not samples.
    assert samples[-1] - FLUSH_S / STEP_S <= len(lines) <= samples[-1] + 2


def test_a_full_disk_leaves_whole_lines(tmp_path):
    disk, path = DiskAtOnce(), tmp_path / "log.csv"
    log = recorder_in(tmp_path, disk)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # a limit of 1 kB that splits a line
    try:
        log.append([Reading(k * STEP_S, (0.0, 0.0, 100.0 + k)) for k in range(200)])
        with pytest.raises(OutputError, match=r"log\.csv: cannot be written: File too large"):
            disk.check()
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes().endswith(b"\n")
    assert {line.count(",") for line in lines_of(path)[1]} == {3}


def test_nothing_waits_for_a_frozen_disk_that_writes_later(tmp_path, monkeypatch):
    thawed, disk = threading.Event(), Disk()
    write, fsync = os.write, os.fsync
    monkeypatch.setattr(recorder.os, "write", lambda *given: thawed.wait(60) and write(*given))
    monkeypatch.setattr(recorder.os, "fsync", lambda file: thawed.wait(60) and fsync(file))
    log = recorder_in(tmp_path, disk)  # no call would return
    log.append(Reading(k * STEP_S, (0.0, 0.0, 1.0)) for k in range(100))
    log.close()
    thawed.set()
    assert disk.finish()
    assert len(lines_of(tmp_path / "log.csv")[1]) == 100
