"""What every comparison shares: measured data, how often is measured, and where times are kept."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import pytest
from timings import OURS, Timing, TimingLog, write_timings

jax.config.update("jax_enable_x64", True)

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[3] / "shared" / "data"))
TIMINGS = pytest.StashKey[list[Timing]]()


@dataclass(frozen=True)
class Pace:
    """How thoroughly is measured.

    Attributes:
        runs: of each whole process and of each slow call.
        quick: whether all work is cut short, to see that it runs; times then mean nothing.
        full: whether what is otherwise scaled up from a sample is run as a whole.
    """

    runs: int
    quick: bool
    full: bool

    @property
    def slow_runs(self) -> int:
        """Runs of what takes minutes."""
        return (self.runs + 1) // 2


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the suite."""
    group = parser.getgroup("speed")
    group.addoption("--runs", type=int, default=5, help="runs of each whole process [5]")
    group.addoption("--quick", action="store_true", help="cut all work short: does it run?")
    group.addoption("--full", action="store_true", help="run as a whole what is scaled up from a sample")
    group.addoption("--timings", type=Path, help="JSON file for the times of whole runs")


def pytest_configure(config: pytest.Config) -> None:
    """Begin without any times."""
    config.stash[TIMINGS] = []


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the times of whole runs."""
    path = session.config.getoption("--timings")
    if path is not None:
        write_timings(path, session.config.stash[TIMINGS])


@pytest.fixture(scope="session")
def pace(request: pytest.FixtureRequest) -> Pace:
    """Return how thoroughly is measured."""
    quick = request.config.getoption("--quick")
    runs = 1 if quick else request.config.getoption("--runs")
    return Pace(runs, quick, request.config.getoption("--full"))


@pytest.fixture(scope="session")
def rig_a() -> Path:
    """Return the folder of measured logs, or skip."""
    if not (DATA / "rig-a").is_dir():
        pytest.skip(f"{DATA / 'rig-a'} is missing; set HITCHID_DATA to the folder of measured data")
    return DATA / "rig-a"


@pytest.fixture
def tally(request: pytest.FixtureRequest) -> TimingLog:
    """Return what takes in times of whole runs."""
    return TimingLog(part_of(request.path), request.config.stash[TIMINGS])


@pytest.fixture
def timed(request: pytest.FixtureRequest, benchmark: Any, pace: Pace) -> Callable[..., Any]:
    """Return a function that times calls after a first one, which compiles and is not counted."""

    def times(
        call: Callable[[], Any],
        what: str,
        by: str = OURS,
        *,
        slow: bool = False,
        bar: tuple[str, float] | None = None,
    ) -> Any:
        benchmark.extra_info.update(part=part_of(request.path), what=what, by=by, bar=bar)
        if slow or pace.quick:
            return benchmark.pedantic(call, rounds=pace.runs, warmup_rounds=1)
        call()
        return benchmark(call)

    return times


def part_of(path: Path) -> str:
    """Return the comparison that a file of tests makes."""
    return path.stem.removesuffix("_test")
