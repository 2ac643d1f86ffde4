"""What every test shares: double precision, shapes checked on request, made-up benches, measured data."""

import atexit
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)

# Compiling is most of the work of the suite, and takes less than half as long with these: the program's code
# generator (`hitchid._support.jax_setup`), and one thread for each program, as there are two workers.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)
# What one file compiled and dropped, or another worker compiled, is read back from a folder of this run
# alone; workers, and the program, find it in the environment.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="hitchid-compiled-")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)

# How long an example takes depends on the machine and on what else it does; `benchmarks/speed` measures. The
# examples are the same in every run: a run that fails has found a fault in what was changed.
settings.register_profile("few", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("full", deadline=None, derandomize=True, max_examples=100)
EXAMPLES = os.environ.get("HITCHID_EXAMPLES", "few")
settings.load_profile(EXAMPLES)

# Types and shapes of every call, which take a third of the time of a test, are checked by `make test-all`.
if EXAMPLES == "full":
    install_import_hook("hitchid", "beartype.beartype")

from benches import write_bench  # noqa: E402
from browser import chromium  # noqa: E402
from hitchid.logs.record import Record  # noqa: E402

# From the longest: begun last, they would keep one core waiting for the other.
LONGEST = ("test_sun2025.py", "test_examples.py", "test_checkpoints.py", "test_selection.py")
# A compiled program is several regions of memory, of which Linux grants a process 65 530 in all; so many
# come with 3 GiB (measured).
MAX_MEMORY_MAPS = 10_000
DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))


def pytest_collection_modifyitems(items):
    """Put the files that take longest first, so that two workers end together."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))


@pytest.fixture(autouse=True, scope="module")
def compiled_programs_are_bounded():
    """Drop compiled programs after a file where they fill much of the memory maps a process may have."""
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_bytes().count(b"\n") > MAX_MEMORY_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Return a function that gives a folder of this run, filled by the first of the workers that asks."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent

    def folder(name: str, fill: Callable[[Path], None]) -> Path:
        filled = shared / name
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (shared / f"{name}.filled").exists():
                shutil.rmtree(filled, ignore_errors=True)
                filled.mkdir()
                fill(filled)
                (shared / f"{name}.filled").touch()
        return filled

    return folder


@pytest.fixture
def data():
    """Return a function that gives the folder of a measured data set, or skips the test."""

    def folder(name: str) -> Path:
        if not (DATA / name).is_dir():
            pytest.skip(f"{DATA / name} is missing; set HITCHID_DATA to the folder of measured data")
        return DATA / name

    return folder


@pytest.fixture(scope="module")
def browser():
    """Return Chromium, or skip what needs it.

    One for each file: two at once, or one beside a test with a loop of its own, are refused by playwright.
    """
    with chromium() as driven:
        yield driven


@pytest.fixture(scope="session")
def bench(tmp_path_factory):
    """Return a folder of made-up logs of a two-way plant, enough of them for every part of a model."""
    return write_bench(tmp_path_factory.mktemp("whole") / "logs")


@pytest.fixture(scope="session")
def identified(once, bench, quick_settings):
    """Return a folder with `model`, identified from `bench`, and `kept`, the pieces kept on the way."""
    import hitchid

    def identify(folder: Path) -> None:
        identification = hitchid.identify(hitchid.read(bench), **quick_settings, checkpoints=folder / "kept")
        identification.save(folder / "model")

    return once("identified", identify)


@pytest.fixture(scope="session")
def bench_folder(tmp_path_factory):
    """Return one small folder of made-up logs of a two-way plant, for tests that only read it."""
    return write_bench(tmp_path_factory.mktemp("bench") / "logs", tests=3, samples=250)


@pytest.fixture(scope="session")
def make_record():
    """Return a function that makes a record of given signals at 100 Hz in mm and A."""

    def make(
        displacement, lifting=None, lowering=None, *, name: str = "test", step_s: float = 0.01
    ) -> Record:
        signals = {"displacement": np.asarray(displacement, dtype=float)}
        if lifting is not None:
            signals["lifting_command"] = np.asarray(lifting, dtype=float)
        if lowering is not None:
            signals["lowering_command"] = np.asarray(lowering, dtype=float)
        units = {role: "mm" if role == "displacement" else "A" for role in signals}
        return Record(name=name, step_s=step_s, signals=signals, units=units)

    return make


@pytest.fixture(scope="session")
def quick_settings():
    """Return arguments of an identification that takes seconds."""
    from hitchid.identification import AdamConfig, CompensatorConfig, MultiStart, SpeedCompensatorConfig
    from hitchid.identification.identify import PAPER_SPECS

    return {
        "structure": PAPER_SPECS,
        "rivals": False,
        "search": MultiStart(evaluations=60),
        "training": CompensatorConfig(
            hidden=6,
            window=20,
            adam=AdamConfig(epochs=8, patience=8),
            free_run=SpeedCompensatorConfig(units=2),
        ),
    }
