"""The real program, stopped: it ends at once, says how to go on, leaves nothing half-written, and goes on."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import benches
import hitchid
from hitchid._support.checkpoints import has_results, is_run
from hitchid.logs import write_table

pytestmark = [pytest.mark.long, pytest.mark.skipif(os.name == "nt", reason="signals are others there")]

PROGRAM = "from hitchid.__main__ import main; main()"
# It should take a second; a machine with other work may take longer.
SOON_S, LONGEST_S = 3.0, 300.0
LIGHT = """
[search]
method = "multi-start"
evaluations = 60
compare = false
[training]
compensator = false
[lifting]
structure = "integrator"
"""
# Loaded by the process that reads logs: its reader of Parquet says that it has begun, and never ends.
HANGING = """
import sys

class Patched:
    def find_spec(self, name, path=None, target=None):
        if name == "hitchid.logs.reader_process":
            sys.meta_path.remove(self)
            import os, time
            from pathlib import Path
            from hitchid.logs import formats

            def hang(path, wanted):
                path.with_name("begun").write_text(str(os.getpid()))
                time.sleep(600)

            known = next(each for each in formats.BUILT_IN if ".parquet" in each.suffixes)
            formats.BUILT_IN = (known._replace(read=hang),)
        return None

sys.meta_path.insert(0, Patched())
"""
COMPUTING = """
import sys
from pathlib import Path
import jax
import hitchid.logs

def look(logs, **_):
    start = jax.numpy.ones(())
    loop = jax.jit(lambda x: jax.lax.while_loop(lambda x: x > 0, lambda x: x / 2 + 1, x))
    endless = loop.lower(start).compile()
    Path(sys.argv[2]).with_name("begun").touch()
    endless(start).block_until_ready()

hitchid.logs.inspect = look
from hitchid.__main__ import main
main()
"""
IMPORTING = """
import sys, time
from pathlib import Path

class Slow:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            Path(sys.argv[2]).with_name("begun").touch()
            time.sleep(600)

sys.meta_path.insert(0, Slow())
from hitchid.__main__ import main
main()
"""


class Started:
    """The program while it runs, in a group of its own as in a terminal."""

    def __init__(self, *arguments, program=PROGRAM, **environment):
        self.child = subprocess.Popen(  # noqa: S603
            [sys.executable, "-c", program, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env={**os.environ, **environment},
        )

    def wait_for(self, ready):
        """Wait until something is so; complain where the program ends before."""
        latest = time.monotonic() + LONGEST_S
        while not ready():
            assert self.child.poll() is None, self.child.communicate()
            assert time.monotonic() < latest
            time.sleep(0.005)

    def interrupt(self):
        """Press Ctrl-C, and return exit code, what it said, and after how long it ended."""
        begun = time.monotonic()
        os.killpg(self.child.pid, signal.SIGINT)
        try:
            out, err = self.child.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            self.kill()
            raise
        return self.child.returncode, out, err, time.monotonic() - begun

    def end(self):
        """Let it run to its end, and return exit code and what it said."""
        out, err = self.child.communicate(timeout=LONGEST_S)
        return self.child.returncode, out, err

    def kill(self):
        self.child.kill()
        self.child.communicate()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with logs that lift, and settings for an identification that takes seconds."""
    folder = tmp_path_factory.mktemp("stopping")
    logs = benches.write_bench(folder / "logs", tests=3, samples=250)
    for log in logs.glob("lowering-*"):
        log.unlink()
    (folder / "light.toml").write_text(LIGHT)
    return folder


@pytest.fixture
def identify(folder, tmp_path):
    """Return a function that starts an identification into the folder `model` of this test's own."""

    def start(*more):
        settings = ("--config", folder / "light.toml", "--quiet")
        arguments = ("identify", folder / "logs", "--out", tmp_path / "model", *settings, *more)
        return Started(*arguments, XDG_CACHE_HOME=str(tmp_path / ".cache"))

    return start


def left_in(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != ".cache")


def stamps(folder):
    """Return when each file of a run was written; files may come and go meanwhile."""
    written = {}
    for path in [folder / "run.json", *folder.glob("*.npz")]:
        with suppress(FileNotFoundError):
            written[path.name] = path.stat().st_mtime_ns
    return written


def has_new_results(folder, before):
    """Return whether another run than the one of some stamps has written a result.

    All is asked of one look at the folder: between two, the old run may be removed.
    """
    now = stamps(folder)
    return "run.json" in now and len(now) > 1 and now.items().isdisjoint(before.items())


def test_a_stopped_identification_is_begun_anew_or_resumed(identify, tmp_path):
    unfinished = tmp_path / "model.unfinished"
    unfinished.mkdir()  # as a stopped removal leaves it
    running = identify()
    running.wait_for(lambda: has_results(unfinished))
    code, out, err, took_s = running.interrupt()
    assert (code, out) == (130, "")
    assert took_s < SOON_S
    (line,) = err.splitlines()
    assert line.startswith("hitchid: stopped")
    assert "--resume" in line
    assert left_in(tmp_path) == ["model.unfinished"]
    assert is_run(unfinished)

    before = stamps(unfinished)
    code, out, err = identify().end()
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert all(word in line for word in ("model.unfinished", "--resume", "--force"))
    assert stamps(unfinished) == before
    assert left_in(tmp_path) == ["model.unfinished"]

    running = identify("--force")
    running.wait_for(lambda: has_new_results(unfinished, before))
    running.kill()
    assert left_in(tmp_path) == ["model.unfinished"]

    before = stamps(unfinished)
    code, out, err = identify("--resume", "--seed", "7").end()
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert "other logs, settings or version" in line
    assert "--force" in line
    assert stamps(unfinished) == before

    assert identify("--resume").end() == (0, "", "")
    assert left_in(tmp_path) == ["model"]
    written = {".hitchid.json", "model.json", "trace.json", "weights.safetensors"}
    assert written <= set(left_in(tmp_path / "model"))


def test_stopped_while_it_trains_it_leaves_the_physics_model(identify, folder, tmp_path):
    # So many epochs that it trains until it is stopped, however busy the host.
    training = "[training]\nepochs = 1000000\npatience = 1000000\nfree_run = false\n"
    form = '[lifting]\nstructure = "integrator"\n[search]\nmethod = "multi-start"\nevaluations = 60\n'
    (tmp_path / "settings.toml").write_text(training + form)
    running = identify("--config", tmp_path / "settings.toml")
    running.wait_for((tmp_path / "model" / "model.json").is_file)
    code, *_ = running.interrupt()
    assert code == 130
    model, campaign = hitchid.load(tmp_path / "model"), hitchid.read(folder / "logs")
    assert all(channel.compensator is None for channel in model.channels.values())
    assert (
        hitchid.validate(model, campaign).metrics["channels"]["lifting"]["greybox"]["free_run"]["rmse"] < 1.0
    )
    assert np.all(np.isfinite(model.simulate(campaign.records[0]).displacement))
    code, out, err = identify("--config", tmp_path / "settings.toml").end()
    assert (code, out) == (2, "")
    assert "--resume" in err


def test_another_folder_is_never_taken_for_a_run(identify, tmp_path):
    (tmp_path / "model.unfinished").mkdir()
    (tmp_path / "model.unfinished" / "precious").write_text("mine")
    for options, said in (
        (("--resume",), "holds no unfinished run"),
        (("--force",), "is not an unfinished run"),
    ):
        code, _, err = identify(*options).end()
        assert code == 2
        (line,) = err.splitlines()
        assert f"model.unfinished: {said}" in line
    assert (tmp_path / "model.unfinished" / "precious").read_text() == "mine"
    assert left_in(tmp_path) == ["model.unfinished"]


def test_a_run_refused_at_once_leaves_nothing(identify, tmp_path):
    # A model that is asked for a second input nobody measured.
    (tmp_path / "settings.toml").write_text(LIGHT + 'load = "pressure"\n')
    code, _, err = identify("--config", tmp_path / "settings.toml").end()
    assert code == 2
    (line,) = err.splitlines()
    assert "pressure" in line
    assert left_in(tmp_path) == ["settings.toml"]


def test_inspect_stops_and_takes_its_reader_with_it(tmp_path):
    (tmp_path / "plugin").mkdir()
    (tmp_path / "plugin" / "sitecustomize.py").write_text(HANGING)
    log, begun = tmp_path / "log.parquet", tmp_path / "begun"
    write_table(log, {"time_s": np.arange(40) / 100, "displacement_mm": np.arange(40.0)})
    running = Started("inspect", log, PYTHONPATH=str(tmp_path / "plugin"))
    running.wait_for(lambda: begun.exists() and begun.read_text())
    code, out, err, took_s = running.interrupt()
    assert (code, out, err) == (130, "", "hitchid: stopped\n")
    assert took_s < SOON_S
    reader = Path(f"/proc/{begun.read_text()}/stat")
    assert not reader.exists() or " Z " in reader.read_text()


@pytest.mark.parametrize("program", [IMPORTING, COMPUTING], ids=["importing", "computing"])
def test_it_stops_whatever_it_is_at(tmp_path, program):
    running = Started("inspect", tmp_path / "logs", program=program)
    running.wait_for((tmp_path / "begun").exists)
    code, out, err, took_s = running.interrupt()
    assert (code, out, err) == (130, "", "hitchid: stopped\n")
    assert took_s < SOON_S
