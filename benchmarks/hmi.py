"""The bench loop, and its page in a real browser: ticks, delay of the picture, stop and others against bars.

Run: python -m benchmarks.hmi [--minutes 1]; exit code 1 where a bar is missed.
"""

import argparse
import csv
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the operator of the tests
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hmi"))

from operated import Operator, process_time_s, resident_mb, served

import fake_bench
from browser import chromium
from hitchid.hmi.bench_loop import BenchLoop
from hitchid.hmi.bench_process import run_in_real_time
from hitchid.hmi.safety import State

STOPS = 40  # stops of a running bench, each a click in the page
WARM_UP_S = 15  # after which buffers have their size
TICKS = 10_000
TICKS_IN_TIME = 3000  # at 100 Hz
BARS = {
    "tick, p99.9 / ms": 2.0,
    "tick with a frozen disk, p99.9 / ms": 2.0,
    "frozen disk known to zero command / ms": 200.0,
    "tick while 4 GB are taken, p99.9 / ms": 2.0,
    "silent sensor known to zero command then / ms": 200.0,
    "start to first picture / s": 4.0,
    "sample to pixel, p95 / ms": 150.0,
    "time between frames, mean / ms": 50.0,  # 20 frames a second
    "server, share of a core / %": 20.0,
    "page heap, growth / MB": 20.0,
    "server memory, growth / MB": 10.0,
    "click to zero, p99 / ms": 100.0,
    "samples missing or twice in the recording": 0.0,
    "requests to other machines": 0.0,
}
# Another program: takes 4 GB, writes to all of them, gives them back, and begins anew.
TAKE_MEMORY = """
import mmap
while True:
    with mmap.mmap(-1, 4 * 10**9) as memory:
        for begin in range(0, len(memory), 10**6):
            memory[begin : begin + 10**6] = bytes(range(250)) * 4000
"""
LONG_TEST = "time_s,lifting_command,lowering_command\n0,0.45,0\n600,0.45,0\n"

# In the page: arm and start slow lifting, click stop at a random time, return the time until the first sample
# with zero commands, ms. A frame has the wall clock of its newest sample; samples are 10 ms apart.
CLICK_TO_ZERO = """async (name) => {
  const { connection } = window.hitchid;
  const plan = { kind: "file", name, campaign: "stops", file: "uploads/hold.csv" };
  await connection.send("arm", { plan });
  await connection.send("start");
  const frames = [];
  const take = ({ detail }) => { if (detail.kind === 0) frames.push(detail); };
  connection.addEventListener("frame", take);
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  while (!frames.some((frame) => frame.values[1] > 0)) await wait(10);
  await wait(37 * Math.random());
  const clicked = Date.now();
  document.querySelector("[data-testid=stop]").click();
  const last = (frame) => frame.values[(frame.rows - 1) * frame.columns + 1];
  let frame;
  while (!(frame = frames.find((each) => each.wallMs >= clicked && last(each) === 0))) await wait(5);
  connection.removeEventListener("frame", take);
  let zeros = 0;
  while (zeros < frame.rows && frame.values[(frame.rows - 1 - zeros) * frame.columns + 1] === 0) zeros += 1;
  await connection.send("reset");
  return frame.wallMs - 10 * (zeros - 1) - clicked;
}"""


@contextmanager
def running() -> Iterator[fake_bench.Bench]:
    """Yield the loop of a machine that moves by 0.1 mm/s, recorded.

    The machine is in plain Python: what takes time is the loop itself.
    """
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        root, plant = Path(folder), fake_bench.Plant()
        (root / "limits.toml").write_text(fake_bench.LIMITS_FILE)
        (root / "uploads").mkdir()
        (root / "uploads" / "hold.csv").write_text(LONG_TEST.replace("0.45", "0.351"))
        patch.setattr(fake_bench, "made", lambda: plant, raising=False)
        bench = fake_bench.Bench(BenchLoop(root, limits_file=root / "limits.toml"), plant)
        bench.ask("connect", source="fake_bench:made")
        bench.ask("record", on=True)
        bench.run(kind="file", name="hold", file="uploads/hold.csv")
        yield bench
        bench.loop.close()


def ticks() -> dict[str, float]:
    """Return how long ticks of a run take, and of one whose disk freezes under it."""
    thawed, write = threading.Event(), os.write
    with running() as bench, pytest.MonkeyPatch.context() as patch:
        usual = [_duration_ms(bench) for _ in range(TICKS)]
        patch.setattr(os, "write", lambda *given: thawed.wait(60) and write(*given))
        frozen = _until_stopped(bench)
        thawed.set()
        return {
            "tick, p99.9 / ms": float(np.percentile(usual, 99.9)),
            "tick with a frozen disk, p99.9 / ms": float(np.percentile(frozen, 99.9)),
            "frozen disk known to zero command / ms": frozen[-1] if _is_closed(bench) else np.inf,
        }


def ticks_while_memory_is_taken() -> dict[str, float]:
    """Return how long ticks take, with the priority of the bench process, until the sensor falls silent."""
    taking = subprocess.Popen([sys.executable, "-c", TAKE_MEMORY])  # noqa: S603 - this Python
    try:
        with running() as bench, ThreadPoolExecutor(1, initializer=run_in_real_time) as real_time:
            usual = real_time.submit(_in_time, bench).result()
            bench.plant.is_silent = True
            silent = real_time.submit(_until_stopped, bench).result()
            bench.tick(100)  # it stays stopped
            known_to_zero_ms = silent[-1] if _is_closed(bench) else np.inf
    finally:
        taking.kill()
        taking.wait()
    return {
        "tick while 4 GB are taken, p99.9 / ms": float(np.percentile(usual, 99.9)),
        "silent sensor known to zero command then / ms": known_to_zero_ms,
    }


def _in_time(bench: fake_bench.Bench) -> list[float]:
    durations, due_s = [], time.monotonic()
    for _ in range(TICKS_IN_TIME):
        durations.append(_duration_ms(bench))
        due_s += fake_bench.STEP_S
        time.sleep(max(0.0, due_s - time.monotonic()))
    return durations


def _until_stopped(bench: fake_bench.Bench) -> list[float]:
    durations, begin_s = [], time.monotonic()
    while bench.state is State.RUNNING and time.monotonic() - begin_s < 10:
        durations.append(_duration_ms(bench))
    return durations


def _is_closed(bench: fake_bench.Bench) -> bool:
    return bench.state is State.STOPPED and not bench.loop.commands.any()


def _duration_ms(bench: fake_bench.Bench) -> float:
    begin_s = time.perf_counter()
    bench.tick()
    return 1e3 * (time.perf_counter() - begin_s)


def show(text: str) -> None:
    """Write a line to standard output at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def heap_mb(page) -> float:
    """Return the memory of the page's objects after a collection, MB."""
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    used = session.send("Runtime.getHeapUsage")["usedSize"]
    session.detach()
    return used / 1e6


def soak(operator, server: int, minutes: float) -> dict[str, float]:
    """Return delay, frame rate, load and growth over minutes of live signals in a window of 60 s."""
    page = operator.page
    page.wait_for_timeout(1000 * WARM_UP_S)
    heap, memory = heap_mb(page), resident_mb(server)
    used_s, begin_s = process_time_s(server), time.monotonic()
    frames = page.evaluate("window.hitchid.stats.frames")
    delays = []
    while time.monotonic() - begin_s < 60 * minutes:
        page.wait_for_timeout(5000)
        delays += page.evaluate("window.hitchid.stats.latency_ms.slice(-100)")
    elapsed_s = time.monotonic() - begin_s
    drawn = page.evaluate("window.hitchid.stats.frames") - frames
    return {
        "sample to pixel, p95 / ms": float(np.percentile(delays, 95)),
        "time between frames, mean / ms": 1e3 * elapsed_s / max(drawn, 1),
        "server, share of a core / %": 100 * (process_time_s(server) - used_s) / elapsed_s,
        "page heap, growth / MB": heap_mb(page) - heap,
        "server memory, growth / MB": resident_mb(server) - memory,
    }


def stops(operator, project: Path) -> dict[str, float]:
    """Return the time from a click on stop to the first sample with zero commands."""
    (project / "uploads").mkdir(exist_ok=True)
    (project / "uploads" / "hold.csv").write_text(LONG_TEST)
    operator.page.reload()
    operator.wait_for_state("idle")
    names = [f"stop-{number:02d}" for number in range(STOPS)]
    waits = [operator.page.evaluate(CLICK_TO_ZERO, name) for name in names]
    return {"click to zero, p99 / ms": float(np.percentile(waits, 99))}


def gaps(recording: Path) -> int:
    """Return the number of samples that are missing or there twice."""
    with recording.open() as file:
        times_s = np.array([float(row["time_s"]) for row in csv.DictReader(file)])
    return int(np.sum(np.abs(np.diff(np.round(times_s / 0.01)) - 1)))


def measure(minutes: float) -> dict[str, float]:
    """Return all figures."""
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        project = Path(folder)
        begin_s = time.monotonic()
        with served(project) as (link, process):
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            operator = Operator(page, link)
            operator.wait_for_state("no source")
            figures = {"start to first picture / s": time.monotonic() - begin_s}
            operator.connect(speed=1)
            operator.record.click()
            figures |= soak(operator, process.pid, minutes)
            operator.record.click()
            figures |= stops(operator, project)
            page.close()
            time.sleep(1)
            (recording,) = (project / "recordings").glob("*.csv")
            figures["samples missing or twice in the recording"] = gaps(recording)
            host = urllib.parse.urlsplit(link).netloc
            others = [url for url in operator.outside if host not in url]
            figures["requests to other machines"] = len(others)
    return figures


def main() -> None:
    """Print each figure beside its bar."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0, help="of live signals")
    minutes = parser.parse_args().minutes
    try:
        figures = ticks() | ticks_while_memory_is_taken() | measure(minutes)
    except pytest.skip.Exception as reason:  # of what drives the browser
        show(f"the operator's page is not measured: {reason}")
        return
    missed = [name for name, bar in BARS.items() if figures[name] > bar]
    for name, bar in BARS.items():
        show(f"{name:45s} {figures[name]:8.3g}   bar {bar:g}{'   MISSED' if name in missed else ''}")
    sys.exit(bool(missed))


if __name__ == "__main__":
    main()
