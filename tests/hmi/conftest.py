"""Bench loops on a plant in plain Python."""

import pytest

import fake_bench
from fake_bench import LIMITS_FILE, Bench, DiskAtOnce, Plant
from hitchid.hmi.bench_loop import BenchLoop


@pytest.fixture
def make_bench(tmp_path, monkeypatch):
    """Return a function that makes a bench loop which is connected to a plant, in a project at `tmp_path`."""
    (tmp_path / "limits.toml").write_text(LIMITS_FILE)

    def make(plant=None, *, limits=True, **options):
        plant = plant or Plant()
        monkeypatch.setattr(fake_bench, "made", lambda: plant, raising=False)
        limits_file = tmp_path / "limits.toml" if limits else None
        options = {"disk": DiskAtOnce(), **options}
        bench = Bench(BenchLoop(tmp_path, limits_file=limits_file, **options), plant)
        bench.ask("connect", source="fake_bench:made")
        return bench

    return make


@pytest.fixture
def write_test(tmp_path):
    """Return a function that writes a file of constant commands for a plan."""

    def write(lifting=0.6, lowering=0.0, duration_s=5.0):
        (tmp_path / "uploads").mkdir(exist_ok=True)
        rows = f"0,{lifting},{lowering}\n{duration_s},{lifting},{lowering}\n"
        path = tmp_path / "uploads" / "next.csv"
        path.write_text(f"time_s,lifting_command,lowering_command\n{rows}")
        return {"kind": "file", "name": "next", "file": "uploads/next.csv"}

    return write


@pytest.fixture
def armed(make_bench, write_test):
    """Return a bench on which a test is armed."""
    bench = make_bench()
    bench.tick()
    bench.ask("arm", plan=write_test())
    return bench


@pytest.fixture
def running(make_bench, write_test):
    """Return a bench on which a test has moved for twenty samples."""
    bench = make_bench()
    bench.run(**write_test())
    bench.tick(20)
    return bench
